"""On a linear model every step of the stochastic map is the Kalman filter's.

With headings that are zero and exactly known, and a laser and wheels that are off along x alone,
all models are linear. The filter here is written out over positions, with full matrices and the
inverse of S, and shares nothing with the code that it checks.
"""

from __future__ import annotations

import numpy as np
import pytest
from estimation_cases import COORDINATES, UPDATES, walls_area

from hiermap_cli.config import Config, OdometryConfig
from hiermap_cli.estimation.constraint import Rows, constrain, prepare
from hiermap_cli.estimation.motion import LASER_X, SCALE, motion
from hiermap_cli.estimation.stochastic_map import (
    StochasticMap,
    add_objects,
    clone_robot,
    initial_map,
    predict,
    remove_objects,
)
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.association.area_filter import observe
from hiermap_cli.perception.segments import END_OPEN, END_VERTEX
from hiermap_cli.perception.views import SegmentView

TOLERANCE = 1e-9
BOTH = pytest.mark.parametrize(
    ("coordinates", "update"), [(c, u) for c in COORDINATES for u in UPDATES]
)
STRAIGHT = OdometryConfig().model_copy(
    update={"sigma_theta_per_sqrt_m": 0.0, "sigma_theta_per_sqrt_rad": 0.0}
)


class Kalman:
    """Mean x and covariance P of (robot x, y, scale, laser x, objects' x and y)."""

    def __init__(self, x, P):
        self.x, self.P = x, P

    def predict(self, d, Q):
        F = np.eye(len(self.x))
        F[:2, 2] = d
        self.x = self.x.copy()
        self.x[:2] += (1.0 + self.x[2]) * d
        self.P = F @ self.P @ F.T
        self.P[:2, :2] += Q

    def add(self, A, offset, C):
        """New components `A x + offset + w`."""
        n = len(self.x)
        T = np.vstack((np.eye(n), A))
        self.x = np.concatenate((self.x, A @ self.x + offset))
        self.P = T @ self.P @ T.T
        self.P[n:, n:] += C

    def update(self, H, z, R):
        S = H @ self.P @ H.T + R
        K = self.P @ H.T @ np.linalg.inv(S)
        y = z - H @ self.x
        self.x = self.x + K @ y
        J = np.eye(len(self.x)) - K @ H
        self.P = J @ self.P @ J.T + K @ R @ K.T
        return y @ np.linalg.inv(S) @ y

    def remove(self, objects, keep):
        at = [*range(4), *(4 + 2 * i + k for i in range(objects) if i in keep for k in range(2))]
        self.x, self.P = self.x[at], self.P[np.ix_(at, at)]

    def row(self, object_, axis):
        """A row (n,) that takes one coordinate of an object."""
        h = np.zeros(len(self.x))
        h[4 + 2 * object_ + axis] = 1.0
        return h

    def robot(self, axis):
        """A row (n,) that takes one coordinate of the robot."""
        h = np.zeros(len(self.x))
        h[axis] = 1.0
        return h

    def sensor(self, axis):
        """A row (n,) that takes one coordinate of the laser."""
        h = np.zeros(len(self.x))
        h[axis] = 1.0
        h[3] = 1.0 - axis
        return h


def started(coordinates, rng):
    """The same beginning for both filters: robot, scale and laser uncertain, headings not."""
    A = rng.normal(size=(2, 2))
    C = 0.01 * (A @ A.T + np.eye(2))
    C_robot, C_parameters = np.zeros((3, 3)), np.zeros((4, 4))
    C_robot[:2, :2] = C
    C_parameters[SCALE, SCALE], C_parameters[LASER_X, LASER_X] = 0.05**2, 0.1**2
    start = np.array([1.0, -2.0, 0.0])
    V = initial_map(start, C_robot, np.zeros(4), C_parameters, coordinates)
    P = np.zeros((4, 4))
    P[:2, :2], P[2, 2], P[3, 3] = C, 0.05**2, 0.1**2
    return V, Kalman(np.array([1.0, -2.0, 0.0, 0.0]), P)


def same(V, kalman):
    """Both filters have the same mean and covariance, and V knows its headings exactly."""
    n = V.objects
    objects = 7 + 3 * np.arange(n)[:, None]
    at = np.concatenate(([0, 1, 3, 6], (objects + np.arange(2)).ravel())).astype(int)
    x = np.concatenate((V.robot[:2], V.parameters[[SCALE, LASER_X]], V.poses[1:, :2].ravel()))
    assert np.abs(x - kalman.x).max() < TOLERANCE
    assert np.abs(V.covariance[np.ix_(at, at)] - kalman.P).max() < TOLERANCE
    rest = np.setdiff1d(np.arange(len(V.covariance)), at)
    assert np.abs(V.covariance[rest]).max(initial=0.0) < TOLERANCE
    assert not V.poses[:, 2].any()


def drive(V, kalman, rng):
    d = rng.normal(size=2)
    step = motion(np.array([*d, 0.0]), V.parameters, STRAIGHT)
    kalman.predict(d, step.covariance[:2, :2])
    return predict(V, step)


def found(V, kalman, rng):
    """Two objects seen for the first time."""
    z, A = 3.0 * rng.normal(size=(2, 2)), 0.05 * rng.normal(size=(2, 2, 2))
    C = np.zeros((2, 3, 3))
    C[:, :2, :2] = A @ A.transpose(0, 2, 1)
    by_parameters = np.zeros((2, 3, 4))
    by_parameters[:, 0, LASER_X] = 1.0
    R_r_l = np.column_stack((z + np.array([V.parameters[LASER_X], 0.0]), np.zeros(2)))
    V = add_objects(V, R_r_l, C, by_parameters)
    sensor = np.array([kalman.sensor(0), kalman.sensor(1)])
    joint = np.zeros((4, 4))
    joint[:2, :2], joint[2:, 2:] = C[0, :2, :2], C[1, :2, :2]
    kalman.add(np.vstack((sensor, sensor)), z.ravel(), joint)
    return V


def seen_again(V, kalman, rng, update):
    """Some objects seen again, with noise that is correlated from one to the other."""
    which = np.sort(rng.permutation(V.objects)[: 1 + int(rng.integers(min(3, V.objects)))])
    A = rng.normal(size=(2 * len(which), 2 * len(which)))
    R = 0.03**2 * (A @ A.T + 0.1 * np.eye(2 * len(which)))
    H = np.array([kalman.row(i, k) - kalman.sensor(k) for i in which for k in range(2)])
    z = H @ kalman.x + 0.1 * rng.normal(size=2 * len(which))

    def measure(U):
        shift = np.array([U.parameters[LASER_X], 0.0])
        return z - (U.poses[1 + which, :2] - U.robot[:2] - shift).ravel()

    H_object = np.concatenate([se2.adjoint(se2.invert(V.poses[1 + i]))[:2] for i in which])
    H_parameters = np.zeros((len(z), 4))
    H_parameters[0::2, LASER_X] = -1.0
    rows = Rows(measure(V), np.repeat(1 + which, 2), H_object, H_parameters)
    V, made = constrain(V, prepare(V, rows, R), measure, update)
    expected = kalman.update(H, z, R)
    assert made.nis == pytest.approx(expected, rel=1e-7)
    return V


@BOTH
@pytest.mark.parametrize("seed", range(4))
def test_every_step_is_the_kalman_filters(coordinates, update, seed):
    """A random walk of predict, add, clone, forget and constrain; what is not seen moves too."""
    rng = np.random.default_rng(seed)
    V, kalman = started(coordinates, rng)
    V = found(V, kalman, rng)
    for step in range(25):
        V = drive(V, kalman, rng)
        same(V, kalman)
        if step % 4 == 1:
            V = found(V, kalman, rng)
        if step % 6 == 2:
            V = clone_robot(V)
            kalman.add(np.eye(2, len(kalman.x)), np.zeros(2), np.zeros((2, 2)))
        if step % 8 == 7:
            keep = np.sort(rng.permutation(V.objects)[: V.objects - 2])
            kalman.remove(V.objects, set(keep.tolist()))
            V = remove_objects(V, keep + 1)
        same(V, kalman)
        V = seen_again(V, kalman, rng, update)
        same(V, kalman)


# --- an area: walls and their ends ---

HEADINGS = np.array([0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi])
HALF = np.array([2.0, 1.5, 2.0, 1.5])


def square_area(coordinates, rng):
    """Four walls about the origin with two ends each but the last; all correlated, all headings
    exact; the Kalman filter over the same positions."""
    normal = np.column_stack((-np.sin(HEADINGS), np.cos(HEADINGS)))
    along = np.column_stack((np.cos(HEADINGS), np.sin(HEADINGS)))
    centres = -normal * np.array([1.5, 2.0, 1.5, 2.0])[:, None]
    ends = [(wall, side) for wall in range(3) for side in range(2)]
    at = [centres[w] + (2 * side - 1) * HALF[w] * along[w] for w, side in ends]
    position = np.vstack((centres, at))
    heading = np.concatenate((HEADINGS, HEADINGS[[w for w, _ in ends]]))
    n = len(position)
    # Independent causes: the walls' offsets, and everything's place along its own wall.
    M = np.zeros((4 + 2 * n, 4 + 4 + n))
    M[:4, :4] = np.diag([0.05, 0.04, 0.0, 0.06])
    for i in range(n):
        wall = i if i < 4 else ends[i - 4][0]
        M[4 + 2 * i : 6 + 2 * i, 4 + wall] = 0.05 * normal[wall]
        M[4 + 2 * i : 6 + 2 * i, 8 + i] = 0.05 * along[wall]
        M[4 + 2 * i : 6 + 2 * i, :2] = np.diag([0.03, 0.02])
    U, _ = np.linalg.qr(rng.normal(size=(M.shape[1], M.shape[1])))
    M = M @ U  # the same covariance, whatever the seed: no component is special
    P = M @ M.T
    x = np.concatenate((np.zeros(4), position.ravel()))
    index = np.array([0, 1, 3, 6, *(7 + 3 * i + k for i in range(n) for k in range(2))])
    full = np.zeros((7 + 3 * n, 7 + 3 * n))
    full[np.ix_(index, index)] = P
    poses = np.vstack((np.zeros(3), np.column_stack((position, heading))))
    V = StochasticMap(poses, np.zeros(4), full, coordinates)
    return walls_area(V, HALF.tolist(), ends), Kalman(x, P), index


def scan_of_walls(kalman, rng):
    """Each wall seen, in part and off by some noise; ends seen as vertices. The headings are
    right, but the filter does not know it."""
    centre, ends, length = [], [], []
    for wall in range(4):
        along = np.array([np.cos(HEADINGS[wall]), np.sin(HEADINGS[wall])])
        origin = kalman.x[4 + 2 * wall : 6 + 2 * wall] - kalman.x[:2]
        origin = origin + 0.02 * rng.normal(size=2)
        lo, hi = -HALF[wall] + 0.02 * rng.normal(), HALF[wall] + 0.02 * rng.normal()
        ends.append([origin + lo * along, origin + hi * along])
        centre.append(origin + 0.3 * along)
        length.append(hi - lo)
    return SegmentView(
        centre=np.array(centre),
        theta=HEADINGS.copy(),
        var_theta=np.full(4, 0.01**2),
        var_y=np.array([1e-4, 2e-4, 3e-4, 4e-4]),
        ends=np.array(ends),
        end_kind=np.array([[END_VERTEX, END_VERTEX]] * 3 + [[END_OPEN, END_OPEN]]),
        end_sigma=np.full((4, 2), 0.02),
        length=np.array(length),
    )


def naive_update(kalman, area, view, step):
    """The same scan by the Kalman filter: offsets of lines at the walls' origins with the lever
    arm's share of the headings' noise, then ends along their walls."""
    m = step.matches
    H, z, k = [], [], len(m.wall)
    R = np.zeros((2 * k + len(m.end), 2 * k + len(m.end)))
    before = kalman.x.copy()
    for row, (s, w) in enumerate(zip(m.segment, m.wall, strict=True)):
        along = np.array([np.cos(HEADINGS[w]), np.sin(HEADINGS[w])])
        normal = np.array([-along[1], along[0]])
        arm = along @ (before[:2] + view.centre[s] - before[4 + 2 * w : 6 + 2 * w])
        G = np.array([[1.0, -arm], [0.0, 1.0]])
        R[2 * row : 2 * row + 2, 2 * row : 2 * row + 2] = (
            G @ np.diag([view.var_y[s], view.var_theta[s]]) @ G.T
        )
        relative = [kalman.row(w, a) - kalman.robot(a) for a in range(2)]
        H += [normal @ relative, np.zeros(len(kalman.x))]
        z += [normal @ view.centre[s], 0.0]
    for row, (s, side, e) in enumerate(zip(m.end_segment, m.end_side, m.end, strict=True)):
        theta = area.V.poses[1 + e, 2]
        along = np.array([np.cos(theta), np.sin(theta)])
        H.append(along @ [kalman.row(e, a) - kalman.robot(a) for a in range(2)])
        z.append(along @ view.ends[s, side])
        R[2 * k + row, 2 * k + row] = view.end_sigma[s, side] ** 2
    return kalman.update(np.array(H), np.array(z), R)


@BOTH
@pytest.mark.parametrize("seed", range(2))
def test_a_scan_of_an_area_is_the_kalman_filters(coordinates, update, seed):
    """From `observe`, with its matching: lines and ends of walls."""
    rng = np.random.default_rng(seed)
    area, kalman, index = square_area(coordinates, rng)
    config = Config(update=update, coordinates=coordinates)
    for key in range(5):
        view = scan_of_walls(kalman, rng)
        step = observe(area, view, key, config)
        assert len(step.matches.wall) == 4
        assert len(step.matches.end) == 6
        assert step.nis == pytest.approx(naive_update(kalman, area, view, step), rel=1e-6)
        area = step.area
        V = area.V
        x = np.concatenate((V.robot[:2], V.parameters[[SCALE, LASER_X]], V.poses[1:, :2].ravel()))
        assert np.abs(x - kalman.x).max() < TOLERANCE
        P = V.covariance[np.ix_(index, index)]
        assert np.abs(P - kalman.P).max() < TOLERANCE
        d = 0.1 * rng.normal(size=2)
        moving = motion(np.array([*d, 0.0]), V.parameters, STRAIGHT)
        kalman.predict(d, moving.covariance[:2, :2])
        area = area._replace(V=predict(V, moving))
