"""The least-squares problem over key poses, walls, wall ends and the odometry's calibration.

Errors are small steps: of a key pose `X <- X exp(xi)` in the robot's frame, of a wall its shift
b along its normal and its turn phi about its origin, of an end its place x along its wall. The
residuals are those of the filter: where a segment lies across its wall and how it is turned
against it, where an end lies along it, and what the odometry says of two key scans on end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.motion import PARAMETERS
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.refinement.odometry import motions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.config import FilterConfig, OdometryConfig
    from hiermap_cli.estimation.noise import NoiseScale
    from hiermap_cli.mapping.keyscans import KeyScans, ScanSegments

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]


class Walls(NamedTuple):
    """W walls: poses (W, 3) in g, X along the wall and the free side on its left, and extents."""

    poses: Array
    lo: Array
    hi: Array


class Ends(NamedTuple):
    """E wall ends: wall (E,), side (E,) 0 at the low end and 1 at the high one, x (E,) along it."""

    wall: Index
    side: Index
    x: Array


class State(NamedTuple):
    """What is estimated. poses: (K, 3) of the key scans in g. parameters: (4,)."""

    poses: Array
    parameters: Array
    walls: Walls
    ends: Ends


MEASURED = (0.3, 3.0)  # bounds of a factor that residuals tell


class Matched(NamedTuple):
    """Which segment shows which wall, and which of its ends which end; a and b of them."""

    segment: Index
    wall: Index
    end_segment: Index
    end_side: Index
    end: Index


class Noise(NamedTuple):
    """Variances of all S segments: across the wall, of the heading, of both ends along it."""

    across: Array
    heading: Array
    ends: Array


class Terms(NamedTuple):
    """Residuals of one kind, n of them with r rows over k variables each.

    scan: (n,) key scan to which each belongs. columns: (n, k) variables. J: (n, r, k). e: (n, r).
    information: (n, r, r), robust weight included. chi2: (n,) without the robust weight.
    rows: (n, 1 or 2) segment, and its side, that each is of; key scan for odometry.
    """

    scan: Index
    columns: Index
    J: Array
    e: Array
    information: Array
    chi2: Array
    rows: Index


class Layout(NamedTuple):
    """Where variables stand in the vector of all: K poses, the parameters, W walls, E ends."""

    keys: int
    walls: int
    ends: int

    @property
    def parameters(self) -> int:
        """The first parameter."""
        return 3 * self.keys

    @property
    def size(self) -> int:
        """Number of variables."""
        return 3 * self.keys + PARAMETERS + 2 * self.walls + self.ends

    def pose(self, i: Index) -> Index:
        """(n, 3) of key poses."""
        return np.asarray(3 * i[:, None] + np.arange(3))

    def wall(self, w: Index) -> Index:
        """(n, 2), shift and turn, of walls."""
        return np.asarray(3 * self.keys + PARAMETERS + 2 * w[:, None] + np.arange(2))

    def end(self, e: Index) -> Index:
        """(n, 1) of ends."""
        return np.asarray(3 * self.keys + PARAMETERS + 2 * self.walls + e[:, None])


def layout(state: State) -> Layout:
    """Of a state's variables."""
    return Layout(len(state.poses), len(state.walls.poses), len(state.ends.x))


def segment_noise(segments: ScanSegments, config: FilterConfig, noise: NoiseScale) -> Noise:
    """As the filter has it at the end of the log (`with_noise`)."""
    var = noise.walls * config.wall_sigma**2
    heading = noise.laser * segments.var_theta + noise.walls * config.wall_sigma_theta**2
    return Noise(
        across=noise.laser * segments.var_y + var,
        heading=heading + var / np.square(np.maximum(segments.length, 0.1)),
        ends=np.square(segments.end_sigma) + noise.walls * config.end_sigma**2,
    )


def measured_noise(noise: Noise, solved: Sequence[Terms], free: int, gate: float) -> Noise:
    """The variances as the residuals of a solution have them, each kind by a factor of its own.

    Args:
        noise: as they were taken to be.
        solved: the terms of odometry, walls and ends at the solution.
        free: number of variables solved for, which the residuals have been fitted by.
        gate: chi-square beyond which a single residual counts as that much: an outlier tells
            nothing of the noise.
    """
    rows = sum(t.e.size for t in solved)
    left = 1.0 - min(free / max(rows, 1), 0.9)
    _, walls, ends = solved

    def factor(squares: Array, variances: Array) -> float:
        if not len(squares):
            return 1.0
        q = np.minimum(squares / variances, gate)
        return float(np.clip(q.mean() / left, *MEASURED))

    s = walls.rows[:, 0]
    across, heading = np.square(walls.e).T
    of_ends = np.square(ends.e[:, 0])
    return Noise(
        across=noise.across * factor(across, noise.across[s]),
        heading=noise.heading * factor(heading, noise.heading[s]),
        ends=noise.ends * factor(of_ends, noise.ends[ends.rows[:, 0], ends.rows[:, 1]]),
    )


def robust_weight(chi2: Array, gate: float) -> Array:
    """1 up to the gate, then falling with chi2: Gaussian noise is left alone, outliers are not."""
    return np.asarray(gate / np.maximum(chi2, gate))


def in_g(state: State, segments: ScanSegments, which: Index, points: Array) -> Array:
    """Points (n, 2) of the robot's frame at some segments' scans, in g."""
    X = state.poses[segments.scan[which]]
    c, s = np.cos(X[:, 2]), np.sin(X[:, 2])
    x, y = points.T
    return np.column_stack((X[:, 0] + c * x - s * y, X[:, 1] + s * x + c * y))


def wall_terms(
    state: State, segments: ScanSegments, noise: Noise, matched: Matched, gate: float
) -> Terms:
    """Each matched segment's centre across its wall, and its heading against it."""
    where, s, w = layout(state), matched.segment, matched.wall
    i = segments.scan[s]
    n, k = len(s), 3 + 2
    W, theta = state.walls.poses[w], state.poses[i, 2]
    d = in_g(state, segments, s, segments.centre[s]) - W[:, :2]
    c, sn = np.cos(W[:, 2]), np.sin(W[:, 2])
    e = np.empty((n, 2))
    e[:, 0] = c * d[:, 1] - sn * d[:, 0]
    e[:, 1] = se2.wrap(theta + segments.theta[s] - W[:, 2])
    J = np.zeros((n, 2, k))
    # The wall's normal in the robot's frame.
    n_x, n_y = np.sin(theta - W[:, 2]), np.cos(theta - W[:, 2])
    x, y = segments.centre[s].T
    J[:, 0, 0], J[:, 0, 1], J[:, 0, 2] = n_x, n_y, n_y * x - n_x * y
    J[:, 1, 2] = 1.0
    J[:, 0, 3], J[:, 0, 4] = -1.0, -(c * d[:, 0] + sn * d[:, 1])
    J[:, 1, 4] = -1.0
    index = np.concatenate((where.pose(i), where.wall(w)), axis=1)
    weight = 1.0 / np.column_stack((noise.across[s], noise.heading[s]))
    chi2 = np.einsum("nr,nr->n", e * weight, e)
    weight *= robust_weight(chi2, gate)[:, None]
    return Terms(i, index, J, e, _diagonal(weight), chi2, s[:, None])


def end_terms(
    state: State, segments: ScanSegments, noise: Noise, matched: Matched, gate: float, bias: float
) -> Terms:
    """Each matched end along its wall.

    bias: how much of an end's sigma is the same in all scans that see it from the same side.
    """
    where, s, side = layout(state), matched.end_segment, matched.end_side
    i, end = segments.scan[s], matched.end
    w = state.ends.wall[end]
    W, theta = state.walls.poses[w], state.poses[i, 2]
    point = segments.ends[s, side]
    d = in_g(state, segments, s, point) - W[:, :2]
    c, sn = np.cos(W[:, 2]), np.sin(W[:, 2])
    e = (c * d[:, 0] + sn * d[:, 1] - state.ends.x[end])[:, None]
    J = np.zeros((len(s), 1, 3 + 1 + 1))
    t_x, t_y = np.cos(theta - W[:, 2]), -np.sin(theta - W[:, 2])
    x, y = point.T
    J[:, 0, 0], J[:, 0, 1], J[:, 0, 2] = t_x, t_y, t_y * x - t_x * y
    J[:, 0, 3] = c * d[:, 1] - sn * d[:, 0]
    J[:, 0, 4] = -1.0
    index = np.concatenate((where.pose(i), where.wall(w)[:, 1:], where.end(end)), axis=1)
    weight = 1.0 / noise.ends[s, side]
    chi2 = np.square(e[:, 0]) * weight
    weight = weight * robust_weight(chi2, gate) * _not_common(state, i, matched, bias)
    rows = np.column_stack((s, side))
    return Terms(i, index, J, e, weight[:, None, None], chi2, rows)


def _not_common(state: State, scan: Index, matched: Matched, bias: float) -> Array:
    """What is left of the weight of ends (n,) when part of their errors is common.

    How an edge comes out between two beams depends on whether one looks at its wall or back past
    it, and however many scans look the same way, that part of the error stays: of n of them the
    mean has the variance `(1 / n + bias^2) sigma^2`.
    """
    wall, side = state.ends.wall[matched.end], state.ends.side[matched.end]
    W = state.walls.poses[wall]
    d = state.poses[scan, :2] - W[:, :2]
    x = np.cos(W[:, 2]) * d[:, 0] + np.sin(W[:, 2]) * d[:, 1] - state.ends.x[matched.end]
    beyond = np.where(side == 1, x, -x) > 0.0
    group = 2 * matched.end + beyond
    return np.asarray(1.0 / (1.0 + bias**2 * np.bincount(group)[group]))


def odometry_terms(
    state: State, keyscans: KeyScans, config: OdometryConfig, factor: float, gate: float
) -> Terms:
    """Two key scans on end: the step between them against the calibrated odometry.

    The parameters act on the step that was made, not on what odometry says of it: its noise
    would be in the regressor too, and make the scale too small (errors in variables).
    """
    where = layout(state)
    step = se2.between(state.poses[:-1], state.poses[1:])
    told = keyscans.increments[1:]
    n = len(step)
    M = motions(told, state.parameters, config)
    e = se2.log(se2.compose(se2.invert(M.pose), step))
    made = uncalibrated(step, state.parameters)
    by_parameters = motions(made, state.parameters, config).by_parameters
    Q = factor * motions(at_least_half(made, told), state.parameters, config).covariance
    failed = ~keyscans.trusted[1:]
    if failed.any():
        spread = np.square([config.fault_sigma_xy, config.fault_sigma_xy, config.fault_sigma_theta])
        Q[failed] += np.diag(spread)
        by_parameters[failed] = 0.0
    J = np.concatenate(
        (-se2.adjoint(se2.invert(step)), np.broadcast_to(np.eye(3), (n, 3, 3)), -by_parameters),
        axis=2,
    )
    i = np.arange(n)
    parameters = where.parameters + np.arange(PARAMETERS)
    index = np.concatenate(
        (where.pose(i), where.pose(i + 1), np.broadcast_to(parameters, (n, PARAMETERS))), axis=1
    )
    information = np.linalg.inv(Q).astype(np.float64, copy=False)
    chi2 = np.einsum("ni,nij,nj->n", e, information, e)
    information *= robust_weight(chi2, gate)[:, None, None]
    return Terms(i, index, J, e, information, chi2, i[:, None])


def uncalibrated(step: Array, parameters: Array) -> Array:
    """The increments (n, 3) that odometry without noise would have told of these steps."""
    a, b, c, lever = parameters
    turn = step[:, 2]
    # Of the point about which odometry turns.
    dx = (step[:, 0] - lever * (np.cos(turn) - 1.0)) / (1.0 + a)
    dy = (step[:, 1] - lever * np.sin(turn)) / (1.0 + a)
    chord_x, chord_y = dx, dy
    dtheta = turn
    for _ in range(4):  # the chord is turned by half of what calibration adds to the turn
        dtheta = (turn - c * dx) / (1.0 + b)
        half = 0.5 * (turn - dtheta)
        cos_h, sin_h = np.cos(half), np.sin(half)
        dx, dy = cos_h * chord_x + sin_h * chord_y, cos_h * chord_y - sin_h * chord_x
    return np.column_stack((dx, dy, dtheta))


def at_least_half(made: Array, told: Array) -> Array:
    """Increments (n, 3) as they were made, or half of what was told where that is more.

    A step that is much shorter than what was told is no better a measure of the noise than that.
    """
    short = np.hypot(made[:, 0], made[:, 1]) < 0.5 * np.hypot(told[:, 0], told[:, 1])
    little = np.abs(made[:, 2]) < 0.5 * np.abs(told[:, 2])
    return np.where(np.column_stack((short, short, little)), 0.5 * told, made)


def stepped(state: State, x: Array) -> State:
    """The state after a step x of all its variables."""
    where = layout(state)
    first = where.parameters
    walls = x[first + PARAMETERS : first + PARAMETERS + 2 * where.walls].reshape(-1, 2)
    W = state.walls.poses.copy()
    W[:, 0] -= np.sin(W[:, 2]) * walls[:, 0]
    W[:, 1] += np.cos(W[:, 2]) * walls[:, 0]
    W[:, 2] = se2.wrap(W[:, 2] + walls[:, 1])
    return State(
        poses=stepped_poses(state.poses, x[:first].reshape(-1, 3)),
        parameters=state.parameters + x[first : first + PARAMETERS],
        walls=state.walls._replace(poses=W),
        ends=state.ends._replace(x=state.ends.x + x[first + PARAMETERS + 2 * where.walls :]),
    )


def stepped_poses(poses: Array, xi: Array) -> Array:
    """Poses (n, 3) after steps (n, 3) in their own frames."""
    return se2.compose(poses, se2.exp(xi))


def _diagonal(weight: Array) -> Array:
    out = np.zeros((*weight.shape, weight.shape[1]))
    k = np.arange(weight.shape[1])
    out[:, k, k] = weight
    return out
