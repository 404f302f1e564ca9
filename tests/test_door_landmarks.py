"""Doors as landmarks of both areas and in g: by their jambs, by a wall, or by the way through."""

from dataclasses import replace

import numpy as np
import pytest
from estimation_cases import COORDINATES, derivative, moved, random_covariance, walls_area

from hiermap_cli.config import LandmarkConfig
from hiermap_cli.documents.checks import covariance_fault
from hiermap_cli.estimation.stochastic_map import StochasticMap
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import ANCHOR, AreaMap
from hiermap_cli.mapping.areas.doors import (
    TURNED,
    DoorInG,
    between_faces,
    door_drafts,
    door_in_g,
    door_sides,
    passages,
)
from hiermap_cli.mapping.areas.joining import JoinedArea
from hiermap_cli.mapping.areas.landmarks import find_landmarks, landmark_model
from hiermap_cli.mapping.areas.walls import wall_lines
from hiermap_cli.mapping.portals import Portal

CONFIG = LandmarkConfig()
# The door lies at (3, 0), looking down out of the area; the robot passed it 1 m beyond.
R_ANCHOR_D = np.array([-1.0, 0.04, -np.pi / 2])
ANCHOR_POSE = np.array([3.0, -1.0, -np.pi / 2])
PORTAL = Portal(0, 50, 1, 0, "door", R_ANCHOR_D, 0.9, 2.0, 0.0)


def area_with(walls, half, ends, coordinates="invariant"):
    """Walls in the line y = 0 and an anchor; ends: (wall, side)."""
    rng = np.random.default_rng(2)
    walls = np.array(walls, dtype=float).reshape(-1, 3)
    at = [se2.compose(walls[w], np.array([(1 if s else -1) * half[w], 0, 0])) for w, s in ends]
    poses = np.array([[3.0, 2.0, 0.3], *walls, *at, ANCHOR_POSE])
    P = random_covariance(rng, 3 + 4 + 3 * (len(poses) - 1), 0.01)
    V = StochasticMap(poses, np.zeros(4), P, coordinates)
    without = V._replace(poses=poses[:-1], covariance=P[:-3, :-3])
    f = walls_area(without, half, ends).features
    row = [50, ANCHOR, -1, 0, 0.0, 0.0, 1, 0]
    columns = [np.append(column, value) for column, value in zip(f, row, strict=True)]
    return one_part(AreaMap(V, type(f)(*columns), 51))


def one_part(area: AreaMap) -> JoinedArea:
    return JoinedArea(area, (0,), np.zeros((1, 3)), (0,))


def door_of(area: JoinedArea, portals=(PORTAL,)):
    """The landmark of the portal, and all landmarks of the area."""
    sides = door_sides(area, portals)
    lines = wall_lines(area.map.V, area.map.features, CONFIG, passages(area, sides))
    drafts, index = door_drafts(area, lines, sides, find_landmarks(lines, CONFIG).kept, CONFIG)
    return drafts[index[0]], drafts


NO_WALL = ([], [], [])
ONE_WALL = ([[1.0, 0.0, 0.0]], [1.5], [])
BOTH_JAMBS = ([[1.0, 0.0, 0.0], [5.0, 0.0, 0.0]], [1.5, 1.5], [(0, 1), (1, 0)])


@pytest.mark.parametrize("case", [NO_WALL, ONE_WALL, BOTH_JAMBS], ids=["no wall", "one", "jambs"])
@pytest.mark.parametrize("coordinates", COORDINATES)
def test_a_door_that_was_crossed_is_a_landmark_whatever_was_mapped_of_it(case, coordinates):
    area = area_with(*case, coordinates)
    draft, _ = door_of(area)
    assert draft.kind == "door"
    assert draft.binds == ("x", "y", "theta")
    np.testing.assert_allclose(draft.pose[:2], [3.0, 0.0], atol=0.1)
    assert abs(se2.wrap(draft.pose[2] - np.pi)) < 0.1  # Y leads out of the area, down
    model = landmark_model(area.map.V, draft, "L1", "A1")
    assert covariance_fault(model.covariance) is None

    def change(e):
        pose = door_of(one_part(area.map._replace(V=moved(area.map.V, e))))[0].pose
        return np.append(pose[:2], se2.wrap(pose[2] - draft.pose[2]))

    numeric = derivative(change, len(area.map.V.covariance))
    np.testing.assert_allclose(draft.pose_by_state, numeric, atol=1e-5)


def test_the_more_is_known_of_a_door_the_less_is_left_open():
    sigma = {}
    for name, case in (("none", NO_WALL), ("one", ONE_WALL), ("both", BOTH_JAMBS)):
        draft, _ = door_of(area_with(*case))
        sigma[name] = np.sqrt(np.diagonal(draft.pose_noise))
    assert (sigma["none"] > 0.0).all()
    assert sigma["one"][0] > 0.0
    np.testing.assert_allclose(sigma["one"][1:], 0.0, atol=1e-12)  # on the wall, by the wall
    np.testing.assert_array_equal(sigma["both"], 0.0)


def test_from_the_other_area_the_door_is_turned():
    area = area_with(*NO_WALL)
    other = replace(PORTAL, a=1, anchor_a=0, b=0, anchor_b=50)
    here, there = door_of(area)[0], door_of(area, (other,))[0]
    np.testing.assert_allclose(se2.compose(here.pose, TURNED), there.pose, atol=1e-12)


def test_only_doors_between_two_areas_are_sides():
    area = area_with(*NO_WALL)
    assert len(door_sides(area, [PORTAL])) == 1
    for kind in ("open", "same", "size"):
        assert not door_sides(area, [replace(PORTAL, kind=kind)])
    assert not door_sides(area, [replace(PORTAL, b=0)])  # both sides are this area


def test_a_door_in_g_lies_midway_between_its_faces():
    area = area_with(*BOTH_JAMBS)
    draft, _ = door_of(area)
    frame = np.array([2.0, 1.0, 0.7])
    C = 1e-4 * np.eye(3)
    face = door_in_g(frame, C, draft, C)
    np.testing.assert_allclose(face.pose, se2.compose(frame, draft.pose), atol=1e-12)
    assert face.width == pytest.approx(1.0)
    assert covariance_fault(face.covariance) is None
    thickness = 0.2
    back = se2.compose(face.pose, np.array([0.0, thickness, np.pi]))
    door = between_faces(face, DoorInG(back, 4.0 * face.covariance, 1.1))
    expected = se2.compose(face.pose, np.array([0.0, 0.5 * thickness, 0.0]))
    np.testing.assert_allclose(se2.between(expected, door.pose), 0.0, atol=1e-12)
    assert door.width == pytest.approx(1.05)
    np.testing.assert_array_equal(door.covariance, 4.0 * face.covariance)
    assert between_faces(face, None) is face
