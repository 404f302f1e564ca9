"""Areas joined out of the solution of the whole log: exact, with every wall once."""

from __future__ import annotations

import numpy as np
import pytest
from test_refinement_run import ring

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import ANCHOR, END, WALL
from hiermap_cli.mapping.areas.joining import join
from hiermap_cli.mapping.areas.rejoin import joined_area
from hiermap_cli.mapping.levels import change_frame
from hiermap_cli.mapping.portals import anchor_index
from hiermap_cli.mapping.refinement.rebuild import sightings
from hiermap_cli.perception.segments import END_OPEN, END_VERTEX

LEAST = 2


@pytest.fixture(scope="module")
def case():
    _, mapper, _, refined = ring(0)
    return mapper, refined, mapper.keyscans.taken()


def in_g(one, levels):
    """The joined area seen from g, with the frame where it is taken for exact."""
    return change_frame(one.map.V, se2.invert(levels.frames[one.parts[0]]))


def test_one_area_is_itself(case):
    _, refined, keyscans = case
    one = joined_area(refined, (1,), keyscans, LEAST)
    assert one.map.V is refined.levels.maps[1]
    assert one.map.features is refined.areas[1].features
    assert one.offset == (0,)
    assert not one.R_0_p.any()


def test_a_place_that_two_parts_share_is_one_place(case):
    """Both anchors of a portal are the same pose, and no error is between them."""
    mapper, refined, keyscans = case
    parts = tuple(range(len(mapper.areas)))
    one = joined_area(refined, parts, keyscans, LEAST)
    V = one.map.V
    assert len(parts) > 1
    for p in mapper.portals:
        i = anchor_index(one.map, one.uid(p.a, p.anchor_a))
        j = anchor_index(one.map, one.uid(p.b, p.anchor_b))
        np.testing.assert_allclose(V.poses[i], V.poses[j], atol=1e-12)
        D = V.covariance[V.columns(i)] - V.covariance[V.columns(j)]
        scale = max(1e-6, np.abs(V.covariance[V.columns(i), V.columns(i)]).max())
        assert np.abs(D[:, V.columns(i)]).max() < 1e-6 * scale
        assert np.abs(D[:, V.columns(j)]).max() < 1e-6 * scale


def test_every_wall_of_the_solution_is_there_once(case):
    mapper, refined, keyscans = case
    parts = tuple(range(len(mapper.areas)))
    one = joined_area(refined, parts, keyscans, LEAST)
    f = one.map.features
    walls = np.flatnonzero(f.kind == WALL)
    matched = refined.matched
    seen = np.bincount(matched.wall, minlength=len(refined.solution.state.walls.poses))
    assert len(walls) == np.count_nonzero(seen >= LEAST)
    assert len(set(f.uid.tolist())) == len(f.uid)
    assert set(f.wall[f.kind == END].tolist()) <= set(f.uid[walls].tolist())
    apart = sum(int((refined.areas[p].features.kind == WALL).sum()) for p in parts)
    assert len(walls) < apart
    assert int(f.seen[walls].sum()) == int(seen[seen >= LEAST].sum())
    anchors = sum(int((refined.areas[p].features.kind == ANCHOR).sum()) for p in parts)
    assert int((f.kind == ANCHOR).sum()) == anchors


def test_the_parts_lie_in_the_joined_area_as_they_lie_in_g(case):
    mapper, refined, keyscans = case
    levels = refined.levels
    parts = (0, len(mapper.areas) - 1)
    one = joined_area(refined, parts, keyscans, LEAST)
    for p, R in zip(parts, one.R_0_p, strict=True):
        np.testing.assert_allclose(
            se2.compose(levels.frames[parts[0]], R), levels.frames[p], atol=1e-12
        )
        # An anchor of the part, by the part's own map and by the joined one.
        f = refined.areas[p].features
        uid = int(f.uid[f.kind == ANCHOR][0])
        own = levels.maps[p].poses[anchor_index(refined.areas[p], uid)]
        here = one.map.V.poses[anchor_index(one.map, one.uid(p, uid))]
        np.testing.assert_allclose(se2.compose(R, own), here, atol=1e-9)


def test_the_robot_is_where_it_was_last(case):
    mapper, refined, keyscans = case
    here = mapper.current
    levels = refined.levels
    other = next(p for p in range(len(mapper.areas)) if p != here)
    parts = tuple(sorted((here, other)))
    one = joined_area(refined, parts, keyscans, LEAST)
    np.testing.assert_allclose(in_g(one, levels).robot, levels.robot, atol=1e-9)


def test_the_covariance_is_that_of_the_whole_and_not_of_independent_parts(case):
    """A part's own walls keep the covariance they have in it; two parts are joined more surely."""
    mapper, refined, keyscans = case
    parts = tuple(range(len(mapper.areas)))
    one = joined_area(refined, parts, keyscans, LEAST)
    C = one.map.V.covariance
    assert np.abs(C - C.T).max() < 1e-12
    assert np.linalg.eigvalsh(C).min() > -1e-9 * np.abs(C).max()
    by_parts = join(
        [
            area.__class__(V, area.features, area.next_uid)
            for V, area in zip(refined.levels.maps, refined.areas, strict=True)
        ],
        mapper.portals,
        parts,
        mapper.current,
    )
    # The same anchors, the same poses; taken for independent they seem less certain than they are.
    exact, loose = [], []
    for p in mapper.portals:
        for part, uid in ((p.a, p.anchor_a), (p.b, p.anchor_b)):
            i = anchor_index(one.map, one.uid(part, uid))
            j = anchor_index(by_parts.map, by_parts.uid(part, uid))
            np.testing.assert_allclose(one.map.V.poses[i], by_parts.map.V.poses[j], atol=1e-9)
            exact.append(np.trace(one.map.V.pose_covariance(i)))
            loose.append(np.trace(by_parts.map.V.pose_covariance(j)))
    assert sum(exact) < 1.001 * sum(loose)


def test_a_grazing_sight_makes_no_wall_longer(case):
    """An end that lies anywhere within four metres, as where beams graze the wall, is not reach."""
    _, refined, keyscans = case
    state, matched, s = refined.solution.state, refined.matched, keyscans.segments
    hit = s._replace(end_kind=np.full_like(s.end_kind, END_OPEN))
    ends, kind, sigma = s.ends.copy(), hit.end_kind.copy(), s.end_sigma.copy()
    ends[:, 1] += 2.0 * np.column_stack((np.cos(s.theta), np.sin(s.theta)))
    kind[:, 1], sigma[:, 1] = END_VERTEX, 4.0 / np.sqrt(12.0)
    grazing = s._replace(
        ends=ends, end_kind=kind, end_sigma=sigma, length=np.maximum(s.length, 4.0)
    )
    reach, again = (
        sightings(0, keyscans._replace(segments=of), state, matched, 0, LEAST)
        for of in (hit, grazing)
    )
    assert len(reach.walls) > 5
    np.testing.assert_array_equal(again.lo, reach.lo)
    # The segment and its wall differ in direction by their noise.
    np.testing.assert_allclose(again.hi, reach.hi, rtol=0, atol=0.02)
