"""Walls and ends in an area's map: rows, noise and new objects by central differences."""

from __future__ import annotations

import numpy as np
import pytest
from estimation_cases import (
    COORDINATES,
    derivative,
    error_of,
    moved,
    random_map,
    view_from,
    walls_area,
    whole_jacobian,
)

from hiermap_cli.estimation.motion import LASER_X
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import END, WALL, add_ends, add_walls, area_from_here, forget
from hiermap_cli.mapping.association.sighting import (
    Matches,
    Seen,
    Sighting,
    Viewpoint,
    match_rows,
    object_frames,
)
from hiermap_cli.mapping.portals import add_anchor
from hiermap_cli.perception.segments import END_VERTEX

VERTICES = (END_VERTEX, END_VERTEX)
NONE = np.zeros(0, dtype=np.int64)


@pytest.fixture(params=COORDINATES)
def coordinates(request):
    return request.param


@pytest.fixture(params=range(3))
def rng(request):
    return np.random.default_rng(request.param)


def scene(rng, coordinates, parameters=4):
    """Three walls, two ends on the first and one on the last, and a scan of them all without
    error: two segments lie on the first wall."""
    V = random_map(rng, 6, coordinates, parameters)
    on = [(0, 0), (0, 1), (2, 1)]
    for k, (wall, side) in enumerate(on):
        V.poses[4 + k] = se2.compose(V.poses[1 + wall], np.array([[-1.5, 1.5][side], 0.0, 0.0]))
    area = walls_area(V, [1.5, 1.0, 1.5], on)
    parts = [(0, -1.5, -0.2), (0, 0.3, 1.5), (1, -0.9, 0.4), (2, -0.5, 1.5)]
    view = view_from(area, parts, [VERTICES] * 4)
    matches = Matches(
        segment=np.array([0, 1, 2, 3]),
        wall=np.array([0, 0, 1, 2]),
        end_segment=np.array([0, 1, 3]),
        end_side=np.array([0, 1, 1]),
        end=np.array([3, 4, 5]),
    )
    return area, view, matches


def innovations(V, view, matches):
    return sighting(V, view, matches).innovations(Viewpoint.of(V))


def sighting(V, view, matches):
    return Sighting.of(object_frames(V), Seen.of(view), matches)


@pytest.mark.parametrize("parameters", [4, 0])
def test_rows_meet_central_differences(rng, coordinates, parameters):
    """What a scan says against errors of robot, walls and ends: measured minus
    predicted falls where the estimate is moved towards what is measured."""
    area, view, matches = scene(rng, coordinates, parameters)
    V = area.V
    rows, _ = match_rows(V, sighting(V, view, matches), view, matches)
    assert np.abs(rows.innovation).max() < 1e-12
    H = whole_jacobian(V, rows)

    def told(e):
        return innovations(moved(V, e), view, matches)

    assert np.allclose(-H, derivative(told, len(V.covariance)), rtol=1e-6, atol=1e-8)


def test_rows_of_a_scan_that_is_off(rng, coordinates):
    """Where the innovation is not zero the rows still are it to first order."""
    area, view, matches = scene(rng, coordinates)
    V = moved(area.V, 1e-4 * rng.normal(size=len(area.V.covariance)))
    rows, _ = match_rows(V, sighting(V, view, matches), view, matches)
    H = whole_jacobian(V, rows)
    D = derivative(lambda e: innovations(moved(V, e), view, matches), len(V.covariance))
    assert np.abs(D + H).max() < 2e-3 * np.abs(H).max()


def test_noise_is_that_of_the_segments_at_the_walls_origins(rng, coordinates):
    """R by differences: segments off by their own y and theta, ends by their x."""
    area, view, matches = scene(rng, coordinates)
    view = view._replace(
        var_y=1e-4 * np.arange(1, 5), var_theta=1e-5 * np.arange(2, 6),
        end_sigma=1e-2 * np.arange(1.0, 9.0).reshape(4, 2),
    )  # fmt: skip

    def told(e):
        """e: y and theta of each segment about its centre, then x of each matched end."""
        normal = np.column_stack((-np.sin(view.theta), np.cos(view.theta)))
        along = np.column_stack((np.cos(view.theta), np.sin(view.theta)))
        off = view._replace(
            centre=view.centre + e[:8:2, None] * normal, theta=view.theta + e[1:8:2]
        )
        ends = view.ends.copy()
        for k, (s, side) in enumerate(zip(matches.end_segment, matches.end_side, strict=True)):
            ends[s, side] += e[8 + k] * along[s]
        return innovations(area.V, off._replace(ends=ends), matches)

    J = derivative(told, 11)
    variances = np.zeros(11)
    variances[:8:2], variances[1:8:2] = view.var_y, view.var_theta
    variances[8:] = view.end_sigma[matches.end_segment, matches.end_side] ** 2
    _, R = match_rows(area.V, sighting(area.V, view, matches), view, matches)
    assert np.allclose(R, J @ np.diag(variances) @ J.T, rtol=1e-6, atol=1e-12)
    assert np.array_equal(R, R.T)


def test_a_scan_is_seen_from_the_robot_whatever_the_lasers_parameter_is(rng):
    """The robot's frame is that from which the mount leads to the laser."""
    V = random_map(rng, 1)
    V.parameters[LASER_X] = 0.3
    viewpoint = Viewpoint.of(V)
    from_object = object_frames(V).local(viewpoint.place)
    expected = se2.between(V.poses[1:], V.robot)
    assert from_object.real == pytest.approx(expected[:, 0])
    assert from_object.imag == pytest.approx(expected[:, 1])
    turn = object_frames(V).unturn * viewpoint.turn
    assert np.angle(turn) == pytest.approx(expected[:, 2])
    assert np.abs(turn) == pytest.approx(1.0)


def test_new_walls_by_central_differences(rng, coordinates):
    """A wall is where the robot sees it, with the line's noise across it, and along it half of
    its length, which no measurement uses."""
    area = walls_area(random_map(rng, 1, coordinates), [1.0])
    _, view, _ = scene(np.random.default_rng(1), coordinates)
    view = view._replace(var_y=1e-4 * np.arange(1, 5), var_theta=1e-5 * np.arange(2, 6))
    new = np.array([3, 1])
    after = add_walls(area, view, new, key=7)
    N = len(area.V.covariance)
    seen = np.column_stack((view.centre[new], view.theta[new]))

    def true_error(e):
        true = moved(area.V, e[:N])
        robot = true.robot
        out = []
        for i, z in enumerate(seen):
            wall = se2.compose(se2.compose(robot, z), se2.exp(e[N + 3 * i : N + 3 * i + 3]))
            out.append(error_of(coordinates, wall, after.V.poses[2 + i]))
        return np.concatenate(out)

    J = derivative(true_error, N + 6)
    Q = np.zeros((N + 6, N + 6))
    Q[:N, :N] = area.V.covariance
    for i, s in enumerate(new):
        half = max(0.5 * view.length[s], 0.5)
        at = N + 3 * i
        Q[range(at, at + 3), range(at, at + 3)] = half**2, view.var_y[s], view.var_theta[s]
    P = after.V.covariance
    assert np.allclose(P[N:, N:], J @ Q @ J.T, rtol=1e-6, atol=1e-9)
    assert np.allclose(P[N:, :N], J @ Q[:, :N], rtol=1e-6, atol=1e-9)
    f = after.features
    assert f.uid.tolist() == [0, 1, 2]
    assert after.next_uid == 3
    assert (f.kind[1:] == WALL).all()
    assert f.lo[1:] == pytest.approx(-0.5 * view.length[new])
    assert f.hi[1:] == pytest.approx(0.5 * view.length[new])
    assert f.seen[1:].tolist() == [1, 1]
    assert f.last[1:].tolist() == [7, 7]


def test_new_ends_by_central_differences(rng, coordinates):
    """An end is where its line is and as turned, and along it where the robot sees it: the
    line is not used a second time."""
    V = random_map(rng, 2, coordinates)
    area = walls_area(V, [1.5, 1.0])
    x, sigma = np.array([1.4, -0.7]), np.array([0.02, 0.03])
    walls = np.array([1, 0])
    after = add_ends(area, walls, x, sigma, np.array([1, 0]), key=4)
    N = len(V.covariance)
    point = [
        se2.between(V.robot, se2.compose(V.poses[1 + w], np.array([along, 0.0, 0.0])))
        for w, along in zip(walls, x, strict=True)
    ]

    def true_error(e):
        """The point seen, projected on the true wall."""
        true = moved(V, e[:N])
        robot = true.robot
        out = []
        for i, (w, z) in enumerate(zip(walls, point, strict=True)):
            wall = true.poses[1 + w]
            along = se2.between(wall, se2.compose(robot, z))[0] + e[N + i]
            end = se2.compose(wall, np.array([along, 0.0, 0.0]))
            out.append(error_of(coordinates, end, after.V.poses[3 + i]))
        return np.concatenate(out)

    J = derivative(true_error, N + 2)
    Q = np.zeros((N + 2, N + 2))
    Q[:N, :N], Q[N:, N:] = V.covariance, np.diag(sigma**2)
    P = after.V.covariance
    assert np.allclose(P[N:, N:], J @ Q @ J.T, rtol=1e-6, atol=1e-9)
    assert np.allclose(P[N:, :N], J @ Q[:, :N], rtol=1e-6, atol=1e-9)
    f = after.features
    assert (f.kind[2:] == END).all()
    assert f.wall[2:].tolist() == [1, 0]
    assert f.side[2:].tolist() == [1, 0]


def test_an_end_stays_on_its_wall(rng):
    """Across and in heading an end's error is its wall's, whatever was learnt before."""
    V = random_map(rng, 1)
    after = add_ends(
        walls_area(V, [1.0]), np.array([0]), np.array([0.9]), np.array([0.02]), np.array([1]), 0
    )
    to_wall = se2.adjoint(se2.invert(after.V.poses[2]))
    n = len(V.covariance)
    D = np.zeros((3, n + 3))
    D[:, n - 3 : n], D[:, n:] = -to_wall, to_wall
    C = D @ after.V.covariance @ D.T
    assert C[1:, 1:] == pytest.approx(np.zeros((2, 2)), abs=1e-12)
    assert C[0, 0] > 1e-4


def test_nothing_new_changes_nothing(rng):
    area = walls_area(random_map(rng, 2), [1.0, 1.0])
    _, view, _ = scene(np.random.default_rng(1), "invariant")
    assert add_walls(area, view, NONE, 3) is area
    assert add_ends(area, NONE, np.zeros(0), np.zeros(0), NONE, 3) is area


def test_what_is_forgotten_leaves_the_rest_as_it_was(rng, coordinates):
    area, _, _ = scene(rng, coordinates)
    after = forget(area, np.array([False, True, False, False, False, True]))
    assert after.features.uid.tolist() == [0, 2, 3, 4]
    keep = np.array([0, 1, 3, 4, 5])
    assert np.array_equal(after.V.poses, area.V.poses[keep])
    columns = np.concatenate(
        [*(np.arange(7),), *(7 + 3 * (k - 1) + np.arange(3) for k in keep[1:])]
    )
    assert np.array_equal(after.V.covariance, area.V.covariance[np.ix_(columns, columns)])
    assert after.next_uid == area.next_uid


def test_a_new_area_takes_the_walls_in_sight_with_their_ends(rng):
    """Only what the last scan saw, no anchor, no end without its wall; nothing renumbered."""
    area, _, _ = scene(rng, "invariant")
    last = np.array([9, 3, 9, 9, 3, 9])  # wall 1 and the second end of wall 0 are out of sight
    area = area._replace(features=area.features._replace(last=last))
    area, anchor = add_anchor(area, 9)
    assert anchor == 6
    fresh = area_from_here(area, 9)
    assert fresh.features.uid.tolist() == [0, 2, 3, 5]
    assert fresh.next_uid == 7
    assert not fresh.V.robot.any()
    assert not fresh.V.covariance[:3].any()
    told = se2.between(area.V.robot, area.V.poses[[1, 3, 4, 6]])
    assert fresh.V.poses[1:] == pytest.approx(told)
    last[0] = 3  # without the wall its ends do not come either
    gone = area_from_here(area._replace(features=area.features._replace(last=np.r_[last, 9])), 9)
    assert gone.features.uid.tolist() == [2, 5]


def test_an_anchor_is_the_robot(rng, coordinates):
    area, _, _ = scene(rng, coordinates)
    after, uid = add_anchor(area, 5)
    assert after.features.uid[-1] == uid == area.next_uid
    assert after.next_uid == uid + 1
    assert np.array_equal(after.V.poses[-1], area.V.robot)
    assert after.V.covariance[-3:, -3:] == pytest.approx(area.V.covariance[:3, :3])
