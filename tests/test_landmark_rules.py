"""The rule sets of all kinds: which lines qualify, where the frame lies, how errors go on."""

from dataclasses import replace

import numpy as np
import pytest
from landmark_cases import (
    ALL,
    CONFIG,
    CORRIDOR,
    CROSSING,
    DOOR,
    PILLAR,
    ROOM,
    WALL,
    found,
    lines_of,
    perturbed,
    seen_from,
)

from hiermap_cli.documents.checks import covariance_fault
from hiermap_cli.geometry import se2
from hiermap_cli.perception import kinds
from hiermap_cli.perception.kinds import rule_sets
from hiermap_cli.perception.kinds.rules import (
    POSE,
    PointShape,
    find_groups,
    pose_covariance,
    re_express,
    shape_covariance,
)
from hiermap_cli.perception.segments import END_FREE, END_OPEN
from hiermap_cli.perception.utility import utility, worth

ELSEWHERE = np.array([0.7, -1.3, 2.1])


def values(shape):
    return np.concatenate([s.mean if isinstance(s, PointShape) else s.pq for s in shape])


# --- what holds of every kind ---


@pytest.mark.parametrize("kind", ALL)
def test_every_kind_is_found(kind):
    assert found(lines_of(ALL[kind]), kind)


@pytest.mark.parametrize("kind", ALL)
def test_pose_and_shape_meet_central_differences(kind):
    lines = lines_of(seen_from(ALL[kind], np.array([0.3, -0.8, 0.35])))
    for rule, group, extraction in found(lines, kind):
        columns = lines.columns(group.lines)
        for k, column in enumerate(columns):
            e = np.zeros(4 * len(lines))
            e[column] = 1e-6
            plus = rule.extract(perturbed(lines, e), group)
            minus = rule.extract(perturbed(lines, -e), group)
            d_pose = plus.pose - minus.pose
            d_pose[2] = se2.wrap(d_pose[2])
            # The corridor's and the wall's origin lies beside a point that is chosen anew with
            # the lines: only what they bind can be compared.
            turn = np.eye(3)
            turn[:2, :2] = se2.rotation(-extraction.pose[2])
            bound = [i for i, name in enumerate(POSE) if name in extraction.binds]
            numeric = (turn @ d_pose / 2e-6)[bound]
            np.testing.assert_allclose(
                (turn @ extraction.pose_D_lines)[bound, k], numeric, atol=2e-7
            )
            if "x" in extraction.binds:
                numeric = (values(plus.shape) - values(minus.shape)) / 2e-6
                np.testing.assert_allclose(extraction.shape_D_lines[:, k], numeric, atol=2e-7)


@pytest.mark.parametrize("kind", ALL)
def test_a_landmark_moves_with_its_lines(kind):
    here = found(lines_of(ALL[kind]), kind)
    there = found(lines_of(seen_from(ALL[kind], ELSEWHERE)), kind)
    assert [group.lines for _, group, _ in here] == [group.lines for _, group, _ in there]
    for (_, _, one), (_, _, other) in zip(here, there, strict=True):
        np.testing.assert_allclose(
            se2.between(other.pose, se2.compose(ELSEWHERE, one.pose)), 0.0, atol=1e-9
        )
        np.testing.assert_allclose(values(one.shape), values(other.shape), atol=1e-9)


@pytest.mark.parametrize("kind", ALL)
def test_covariances_are_sound_and_what_is_exact_has_zero_rows(kind):
    lines = lines_of(seen_from(ALL[kind], ELSEWHERE), rng=np.random.default_rng(3))
    for _, group, extraction in found(lines, kind):
        C_pose = pose_covariance(lines, group, extraction)
        C_shape = shape_covariance(lines, group, extraction)
        assert covariance_fault(C_pose) is None
        assert covariance_fault(C_shape) is None
        exact = ~extraction.shape_D_lines.any(axis=1)
        assert not C_shape[exact].any()
        assert (np.diagonal(C_shape)[~exact] > 0.0).all()


@pytest.mark.parametrize("kind", ALL)
def test_lines_of_the_shape_keep_to_their_chart_and_their_ends(kind):
    for _, _, extraction in found(lines_of(ALL[kind]), kind):
        for shape in extraction.shape:
            if isinstance(shape, PointShape):
                continue
            p, q = shape.pq
            assert abs(p) <= 1.0
            x, y = shape.ends.T
            off = x - p * y - q if shape.line_type == 0 else y - p * x - q
            np.testing.assert_allclose(off, 0.0, atol=1e-9)


# --- corners ---


def test_a_room_has_concave_corners_and_a_pillar_convex_ones():
    assert {g.kind for _, g, _ in found(lines_of(ROOM)) if "corner" in g.kind} == {"corner_concave"}
    assert {g.kind for _, g, _ in found(lines_of(PILLAR)) if "corner" in g.kind} == {
        "corner_convex"
    }
    assert len(found(lines_of(ROOM), "corner_concave")) == 4
    assert len(found(lines_of(PILLAR), "corner_convex")) == 4


def test_a_corners_frame_lies_at_the_vertex_along_the_longer_line():
    corner = ROOM[:2]  # in along 5 m, out along 4 m
    ((_, _, extraction),) = found(lines_of(corner), "corner_concave")
    np.testing.assert_allclose(extraction.pose, [5.0, 0.0, np.pi], atol=1e-12)
    on, other = extraction.shape
    np.testing.assert_array_equal(on.pq, 0.0)
    np.testing.assert_allclose(on.ends, [[5.0, 0.0], [0.0, 0.0]], atol=1e-12)
    assert other.line_type == 0
    np.testing.assert_allclose(other.pq, 0.0, atol=1e-12)
    assert not extraction.shape_D_lines[[0, 1, 3]].any()  # 4 parameters become 3 and 1
    assert extraction.shape_D_lines[2].any()


def test_p_is_the_tangent_of_the_angle_between_the_lines():
    phi = 0.6
    far = 4.0 * np.array([np.cos(np.pi - phi), np.sin(np.pi - phi)])
    corner = np.array([[[-6.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], far]])
    ((_, _, extraction),) = found(lines_of(corner), "corner_concave")
    other = extraction.shape[1]
    assert other.line_type == 1
    np.testing.assert_allclose(abs(other.pq[0]), np.tan(phi), atol=1e-12)


def test_equally_long_lines_choose_by_the_material():
    square = np.array([[[-3.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 3.0]]])
    ((_, _, concave),) = found(lines_of(square), "corner_concave")
    assert concave.pose[2] == pytest.approx(np.pi / 2)  # along the outgoing line
    square[1, 1] = [0.0, -3.0]
    ((_, _, convex),) = found(lines_of(square), "corner_convex")
    assert abs(convex.pose[2]) == pytest.approx(np.pi)  # against the incoming one


def test_a_later_view_keeps_the_frame_where_lengths_would_turn_it():
    first = lines_of(ROOM[:2])
    ((_, _, known),) = found(first, "corner_concave")
    # From nearer the other wall, less of the first one is in sight.
    short = ROOM[:2].copy()
    short[0, 0] = [3.5, 0.0]
    lines = lines_of(short, kind=[[END_OPEN, END_FREE], [END_FREE, END_FREE]])
    ((rule, group, alone),) = found(lines, "corner_concave")
    assert abs(se2.wrap(alone.pose[2] - known.pose[2])) == pytest.approx(np.pi / 2)
    again = rule.extract(lines, re_express(rule, lines, group, known.pose[2] + 0.3))
    np.testing.assert_allclose(se2.between(known.pose, again.pose), 0.0, atol=1e-12)


def test_a_wall_that_goes_on_makes_no_corner():
    through = np.array([[[-4.0, 0.0], [4.0, 0.0]], [[0.0, 0.0], [0.0, 3.0]]])
    assert not found(lines_of(through), "corner_concave")


# --- doors ---


def test_a_doors_frame_lies_between_the_jambs_and_looks_out():
    ((_, _, extraction),) = found(lines_of(DOOR), "door")
    np.testing.assert_allclose(extraction.pose[:2], [2.45, 0.0], atol=1e-12)
    assert abs(extraction.pose[2]) == pytest.approx(np.pi)  # Y is -y: the material's side
    first, second = extraction.shape[:2]
    np.testing.assert_allclose(first.mean, [0.45, 0.0], atol=1e-12)
    np.testing.assert_allclose(second.mean, [-0.45, 0.0], atol=1e-12)


def test_from_the_other_side_both_axes_flip_and_the_thickness_lies_between():
    thickness = 0.2
    inside = found(lines_of(DOOR), "door")[0][2].pose
    other_face = DOOR[::-1, ::-1] - np.array([0.0, thickness])
    outside = found(lines_of(other_face), "door")[0][2].pose
    R = se2.between(inside, outside)
    np.testing.assert_allclose(R, [0.0, thickness, np.pi], atol=1e-12)


@pytest.mark.parametrize(("width", "is_door"), [(0.5, False), (0.8, True), (1.3, True), (2, False)])
def test_a_doors_width(width, is_door):
    walls = DOOR.copy()
    walls[1, 0, 0] = 2.0 + width
    assert bool(found(lines_of(walls), "door")) == is_door


def test_a_gap_with_open_ends_is_no_door():
    assert not found(lines_of(DOOR, kind=[[2, END_OPEN], [2, 2]]), "door")


def test_a_cabinet_before_a_wall_is_no_door():
    cabinet = np.array([[[2.0, 0.0], [2.0, 0.4]], [[2.0, 0.4], [2.9, 0.4]], [[2.9, 0.4], [2.9, 0]]])
    assert not found(lines_of(np.concatenate((DOOR, cabinet))), "door")
    assert not found(lines_of(np.concatenate((DOOR, cabinet[:1]))), "door")


def test_a_recess_is_no_door():
    back = np.array([[[2.0, -0.6], [2.9, -0.6]]])
    assert not found(lines_of(np.concatenate((DOOR, back))), "door")


def test_a_passage_that_was_crossed_is_a_door_by_its_nearest_ends():
    # A thick wall's inner faces are all that ends at the jambs: no line leads along the wall.
    faces = np.array([[[2.0, 0.0], [2.0, -0.6]], [[2.9, -0.6], [2.9, 0.0]]])
    assert not found(lines_of(faces), "door")
    passages = np.array([[2.4, -0.05, np.pi, 0.85]])
    ((_, _, extraction),) = found(lines_of(faces, passages=passages), "door")
    np.testing.assert_allclose(extraction.pose[:2], [2.45, 0.0], atol=1e-12)
    assert abs(extraction.pose[2]) == pytest.approx(np.pi)
    # With walls in line they give the heading, and the same jambs.
    turned = DOOR.copy()
    turned[1, 1] = [6.0, 0.05]
    wider = turned + np.array([[[0, 0], [0, 0]], [[0.6, 0], [0.6, 0]]])  # no door by itself
    passages[0, 3] = 1.5
    passages[0, 0] = 2.7
    assert not found(lines_of(wider), "door")
    assert len(found(lines_of(wider, passages=passages), "door")) == 1


def across_and_turn(walls):
    """Deviations across the wall and of the heading of a door passed downwards at x = 2.45."""
    lines = lines_of(walls, passages=np.array([[2.45, -0.05, np.pi, 0.9]]))
    ((_, group, extraction),) = found(lines, "door")
    C = pose_covariance(lines, group, extraction)
    return extraction.pose, np.sqrt(C[1, 1]), np.sqrt(C[2, 2])


def test_jambs_of_the_walls_other_face_tell_a_door_to_the_walls_thickness():
    far = DOOR[:, ::-1] - np.array([0.0, 0.15])  # the free side is below: this area's is not seen
    pose, across, turn = across_and_turn(far)
    np.testing.assert_allclose(pose[:2], [2.45, -0.15], atol=1e-12)
    assert abs(pose[2]) == pytest.approx(np.pi)  # out of the area, all the same
    assert 0.15 <= across < 0.16
    assert turn < 0.03
    # One of them turns the jamb line too; the other is a thick wall's inner face.
    inner = np.array([[[2.0, 0.0], [2.0, -0.15]]])
    pose, across, turn = across_and_turn(np.concatenate((inner, far[1:])))
    assert abs(pose[1]) < 2.0 * across < 0.16
    assert abs(se2.wrap(pose[2] - np.pi)) < 1.5 * turn
    # Along the wall the jambs are as good as ever; and so is all where this face was seen.
    lines = lines_of(far, passages=np.array([[2.45, -0.05, np.pi, 0.9]]))
    ((_, group, extraction),) = found(lines, "door")
    assert np.sqrt(pose_covariance(lines, group, extraction)[0, 0]) < 0.02
    for near in (DOOR, np.concatenate((DOOR[:1], far[1:])), np.concatenate((far[:1], DOOR[1:]))):
        pose, across, _ = across_and_turn(near)
        assert pose[1] == pytest.approx(0.0, abs=1e-9)
        assert across < 0.02


# --- corridors, crossings, walls ---


def test_a_corridor_binds_what_its_walls_do():
    ((_, group, extraction),) = found(lines_of(CORRIDOR), "corridor")
    assert extraction.binds == ("y", "theta")
    assert extraction.pose[1] == pytest.approx(0.9)
    assert extraction.pose[2] == pytest.approx(0.0)  # the first wall's direction
    lines = lines_of(CORRIDOR)
    C = pose_covariance(lines, group, extraction)
    assert C[0, 0] > 1.0
    assert C[1, 1] < 1e-3
    widths = [shape.pq[1] for shape in extraction.shape]
    np.testing.assert_allclose(widths, [-0.9, 0.9], atol=1e-12)


def test_walls_that_turn_their_backs_or_are_far_apart_are_no_corridor():
    assert not found(lines_of(CORRIDOR[:, ::-1]), "corridor")
    wide = CORRIDOR.copy()
    wide[1, :, 1] = 5.0
    assert not found(lines_of(wide), "corridor")


def test_doors_do_not_cut_a_corridor_in_two():
    pieces = np.array(
        [[[0, 0], [2, 0]], [[3, 0], [5, 0]], [[6, 0], [8, 0]], [[8, 2], [4, 2]], [[3, 2], [0, 2]]],
        dtype=float,
    )
    assert len(found(lines_of(pieces), "corridor")) == 1
    assert not found(lines_of(pieces[[0, 4]]), "corridor")


def test_a_crossing_is_the_mouth_of_a_side_corridor():
    ((_, group, extraction),) = found(lines_of(CROSSING), "crossing")
    assert group.lines == (0, 1, 2, 3)
    np.testing.assert_allclose(extraction.pose[:2], [4.0, 0.0], atol=1e-12)
    assert abs(extraction.pose[2]) == pytest.approx(np.pi)  # Y into the side corridor
    assert not found(lines_of(CROSSING), "door")


def test_a_lone_wall_is_anchored_at_its_end_where_one_is_known():
    def one(kind):
        ((_, group, extraction),) = found(lines_of(WALL, kind=[kind]), "wall")
        return group, extraction

    _, both = one([END_FREE, END_FREE])
    np.testing.assert_allclose(both.pose[:2], [1.0, 2.0])
    assert both.binds == ("x", "y", "theta")
    _, second = one([END_OPEN, END_FREE])
    np.testing.assert_allclose(second.pose[:2], [4.0, 3.0])
    group, neither = one([END_OPEN, END_OPEN])
    np.testing.assert_allclose(neither.pose[:2], [2.5, 2.5])
    assert neither.binds == ("y", "theta")
    C = pose_covariance(lines_of(WALL, kind=[[0, 0]]), group, neither)
    along = se2.rotation(neither.pose[2])[:, 0]
    assert np.sqrt(along @ C[:2, :2] @ along) == pytest.approx(0.5 * np.hypot(3.0, 1.0), rel=0.01)


def test_walls_of_corners_are_no_landmarks_by_themselves():
    assert not found(lines_of(ROOM), "wall")


# --- utility ---


def test_utility_grows_with_length_and_with_sightings():
    lines = lines_of(ROOM)
    short = lines_of(np.array([[[4.6, 0.0], [5.0, 0.0]], [[5.0, 0.0], [5.0, 0.4]]]))
    (_, group, extraction), *_ = found(lines, "corner_concave")
    ((_, other, small),) = found(short, "corner_concave")
    assert worth(lines, group, extraction, CONFIG) > worth(short, other, small, CONFIG) > 0.0
    twice = replace(lines, seen=2 * lines.seen)
    assert utility(twice, group, extraction, CONFIG) == pytest.approx(
        2 * utility(lines, group, extraction, CONFIG)
    )


def test_a_full_pose_is_worth_more_than_a_wall():
    corner = lines_of(ROOM)
    (_, group, extraction), *_ = found(corner, "corner_concave")
    wall = lines_of(ROOM[:1], kind=[[0, 0]])
    ((_, alone, single),) = found(wall, "wall")
    assert worth(corner, group, extraction, CONFIG) > worth(wall, alone, single, CONFIG)


def test_utility_does_not_depend_on_the_frame():
    one, other = lines_of(ROOM), lines_of(seen_from(ROOM, ELSEWHERE))
    for (_, g1, e1), (_, g2, e2) in zip(found(one), found(other), strict=True):
        assert worth(one, g1, e1, CONFIG) == pytest.approx(worth(other, g2, e2, CONFIG))


# --- the table of kinds ---

NEW_KIND = '''
"""Niches, for a test."""
import numpy as np
from hiermap_cli.perception.kinds.rules import POSE, Extraction, Group, exact_segment

class Niches:
    kinds: tuple[str, ...] = ("niche",)
    rank: int = 5
    choices: tuple[int, ...] = ()

    def find(self, lines, taken, config):
        return [Group("niche", (i,)) for i in range(len(lines)) if lines.length[i] < 0.5]

    def extract(self, lines, group):
        pose = np.append(lines.ends[group.lines[0], 0], lines.theta[group.lines[0]])
        shape = (exact_segment(pose, lines, group.lines[0]),)
        return Extraction(POSE, pose, np.zeros((3, 4)), shape, np.zeros((2, 4)), np.zeros(3))

RULES = Niches()
'''


def test_a_new_kind_is_one_new_file(tmp_path, monkeypatch):
    before = [rules.kinds for rules in rule_sets()]
    (tmp_path / "niche_of_a_test.py").write_text(NEW_KIND)
    monkeypatch.setattr(kinds, "__path__", [*kinds.__path__, str(tmp_path)])
    rules = rule_sets()
    assert [r.kinds for r in rules] == [("niche",), *before]
    lines = lines_of(np.array([[[0.0, 0.0], [0.4, 0.0]]]))
    assert [group.kind for _, group in find_groups(lines, rules, CONFIG)] == ["niche"]


def test_the_table_has_the_kinds_of_the_paper():
    names = {name for rules in rule_sets() for name in rules.kinds}
    assert {"corner_concave", "corner_convex", "door", "corridor", "crossing", "wall"} <= names


def test_no_lines_no_landmarks():
    assert find_groups(lines_of(np.zeros((0, 2, 2))), rule_sets(), CONFIG) == []
