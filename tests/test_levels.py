"""Areas and environment as one: loops of the environment correct what the areas hold."""

import numpy as np
import pytest
from estimation_cases import COORDINATES, random_covariance, walls_area

from hiermap_cli.config import Config
from hiermap_cli.documents.checks import covariance_fault, first_bad_covariance
from hiermap_cli.estimation.stochastic_map import StochasticMap
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import ANCHOR, AreaMap, Features
from hiermap_cli.mapping.levels import compose_levels
from hiermap_cli.mapping.mapper import Mapper
from hiermap_cli.mapping.portals import Portal, anchor_index

CONFIG = Config()
DOOR = np.array([-0.5, 0.1, -1.5])


def area_with_anchors(rng, anchors: np.ndarray, coordinates: str, *, entered: bool) -> AreaMap:
    """An area of two walls and an end, and anchors with uids 100, 101, ...

    An area that was entered began at its first anchor: exactly known, at the origin.
    """
    walls = np.array([[1.0, 0.0, 0.0], [2.0, 1.0, np.pi / 2]])
    end = se2.compose(walls[:1], np.array([[1.0, 0.0, 0.0]]))
    poses = np.concatenate(([[1.5, 1.5, 0.4]], walls, end))
    n = 3 + 4 + 9 + 3 * len(anchors)
    P = random_covariance(rng, n, 0.01)
    if entered:
        anchors = np.concatenate((np.zeros((1, 3)), anchors[1:]))
        P[16:19] = P[:, 16:19] = 0.0
    V = StochasticMap(np.concatenate((poses, anchors)), np.zeros(4), P, coordinates)
    f = walls_area(
        StochasticMap(poses, np.zeros(4), P[:16, :16], coordinates), [1.0, 1.0], [(0, 1)]
    ).features
    k = len(anchors)
    more = Features(
        uid=100 + np.arange(k),
        kind=np.full(k, ANCHOR),
        wall=np.full(k, -1),
        side=np.zeros(k, dtype=np.int64),
        lo=np.zeros(k),
        hi=np.zeros(k),
        seen=np.ones(k, dtype=np.int64),
        last=np.zeros(k, dtype=np.int64),
    )
    features = Features(*(np.concatenate(pair) for pair in zip(f, more, strict=True)))
    return AreaMap(V, features, 100 + k)


def portal(a, uid_a, b, uid_b, kind="door"):
    return Portal(a, uid_a, b, uid_b, kind, DOOR, 0.9, 2.0, 0.0)


def mapper_of(coordinates: str, *, loop: bool) -> Mapper:
    """Two areas and a door; with a loop they have a second place in common, 2 cm off."""
    rng = np.random.default_rng(4)
    first = np.array([[2.0, 0.5, 0.3], [-1.0, 2.0, 1.0]])
    second = se2.compose(se2.invert(first[0]), first)
    second[1] += [0.02, -0.01, 0.005]
    mapper = Mapper(CONFIG)
    mapper.areas += [
        area_with_anchors(rng, first, coordinates, entered=False),
        area_with_anchors(rng, second, coordinates, entered=True),
    ]
    mapper.portals.append(portal(0, 100, 1, 100))
    if loop:
        mapper.portals.append(portal(0, 101, 1, 101, "open"))
    mapper.current = 1
    for k, area in enumerate(mapper.areas):
        mapper.trail.key(k * 1000, k, area.V)
    return mapper


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_an_area_is_seen_from_its_door(coordinates):
    mapper = mapper_of(coordinates, loop=False)
    levels = compose_levels(mapper)
    np.testing.assert_array_equal(levels.shifts, [[0, 0, 0], DOOR])
    door = se2.compose(mapper.areas[0].V.poses[anchor_index(mapper.areas[0], 100)], DOOR)
    np.testing.assert_allclose(levels.frames[1], door, atol=1e-12)
    np.testing.assert_allclose(
        se2.compose(DOOR, levels.maps[1].poses), mapper.areas[1].V.poses, atol=1e-12
    )
    np.testing.assert_allclose(levels.trajectory.poses[1], levels.robot, atol=1e-12)
    np.testing.assert_allclose(
        levels.robot, se2.compose(levels.frames[1], levels.maps[1].robot), atol=1e-12
    )
    J = se2.additive_D_invariant(levels.robot)
    np.testing.assert_allclose(
        levels.trajectory.covariances[1], J @ levels.covariance[:3, :3] @ J.T, atol=1e-12
    )


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_after_a_loop_both_areas_agree_on_the_places_that_they_share(coordinates):
    mapper = mapper_of(coordinates, loop=True)
    free = compose_levels(mapper_of(coordinates, loop=False))
    levels = compose_levels(mapper)
    for uid in (100, 101):
        seen = [
            se2.compose(levels.frames[i], levels.maps[i].poses[anchor_index(area, uid)])
            for i, area in enumerate(mapper.areas)
        ]
        np.testing.assert_allclose(se2.between(*seen), 0.0, atol=1e-7)
    apart = [
        se2.compose(free.frames[i], free.maps[i].poses[anchor_index(area, 101)])
        for i, area in enumerate(mapper.areas)
    ]
    assert np.hypot(*se2.between(*apart)[:2]) > 0.015
    for before, after in zip(free.maps, levels.maps, strict=True):
        # Walls and robot go with the anchors, and are known better than before, never worse.
        assert (np.abs(after.poses[:4] - before.poses[:4]).max(axis=1) > 1e-6).all()
        assert covariance_fault(after.covariance) is None
        gain = before.covariance - after.covariance
        if coordinates == "invariant":
            assert np.linalg.eigvalsh(gain).min() > -1e-12
        assert np.trace(gain) > 0.0
    assert first_bad_covariance(levels.trajectory.covariances) is None
    assert np.trace(levels.covariance) < np.trace(free.covariance)


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_what_an_area_knows_beyond_its_anchors_is_left_alone(coordinates):
    """Given robot and anchors, the loop tells nothing more of the walls: the conditional
    covariance of the rest stays."""
    before = compose_levels(mapper_of(coordinates, loop=False)).maps[0].covariance
    after = compose_levels(mapper_of(coordinates, loop=True)).maps[0].covariance

    def conditional(C):
        given = np.r_[0:3, 16:22]
        rest = np.r_[3:16]
        cross = C[np.ix_(rest, given)]
        return C[np.ix_(rest, rest)] - cross @ np.linalg.solve(C[np.ix_(given, given)], cross.T)

    if coordinates == "invariant":  # additive blocks are those of poses that have moved
        np.testing.assert_allclose(conditional(after), conditional(before), rtol=1e-6, atol=1e-12)
    else:
        assert np.trace(conditional(after)) == pytest.approx(np.trace(conditional(before)), rel=0.1)
