"""What speaks for a hypothesis of how one fragment lies to another: walls laid on walls."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LoopConfig
    from hiermap_cli.mapping.loops.correspondences import Correspondences
    from hiermap_cli.mapping.loops.fragments import Walls

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]


class Evidence(NamedTuple):
    """Figures of M hypotheses, (M,) each unless said otherwise.

    overlap: metres of wall on wall. cross: metres of it that hold the direction which is held
    least (the smaller eigenvalue of the sum of overlap times n n^T): next to nothing in a
    corridor. walls: of j, that lie on walls of i. pairs: constellations of two walls that are
    not parallel, no wall in two of them. information: (M, 3, 3) of `log(R_i_j R_i_j_hat^-1)`.
    """

    overlap: Array
    cross: Array
    walls: Index
    pairs: Index
    information: Array


class _Laid(NamedTuple):
    """Walls laid on walls: hypothesis (n,), a, b (n,), overlap (n,) in metres.

    ends: (n, 2, 2) of the overlap, on b, in the frame of i. across: (n, 2) how far they are off
    wall a. n: (n, 2) normals of a.
    """

    hypothesis: Index
    a: Index
    b: Index
    overlap: Array
    ends: Array
    across: Array
    n: Array


def explained(
    walls: Walls, pairs: Correspondences, count: int, whose: Index, poses: Array, config: LoopConfig
) -> Array:
    """Metres of the walls of j that each hypothesis lays on walls of i, (h,).

    Args:
        walls: of all fragments.
        pairs: the correspondences of `count` candidates, by candidate.
        count: candidates.
        whose: (h,) candidate of each hypothesis.
        poses: (h, 3) R_i_j.
        config: tolerances.
    """
    laid = _laid(walls, pairs, count, whose, poses, 1.0, config)
    return np.asarray(np.bincount(laid.hypothesis, laid.overlap, len(whose)), dtype=float)


def fitted(
    walls: Walls, pairs: Correspondences, count: int, whose: Index, poses: Array, reach: float,
    config: LoopConfig,
) -> Array:  # fmt: skip
    """The poses moved so that walls lie on walls, one step of weighted least squares: (h, 3).

    The weight is a wall's overlap, less where it is off by more than walls are uneven. What the
    walls do not hold stays.
    """
    laid = _laid(walls, pairs, count, whose, poses, reach, config)
    weight = laid.overlap[:, None] / (1.0 + np.square(laid.across / config.sigma_wall))
    rows = _rows(laid)
    A = _sums(laid.hypothesis, len(whose), rows, weight)
    g = np.zeros((len(whose), 3))
    for k in range(3):
        g[:, k] = np.bincount(
            laid.hypothesis, -(weight * rows[..., k] * laid.across).sum(axis=1), len(whose)
        )
    A += np.diag([0.05, 0.05, 0.05])
    step = np.asarray(np.linalg.solve(A, g[..., None])[..., 0], dtype=float)
    return se2.compose(se2.exp(step), poses)


def evidence(
    walls: Walls, pairs: Correspondences, count: int, whose: Index, poses: Array, config: LoopConfig
) -> Evidence:
    """The figures of hypotheses; arguments as for `explained`."""
    h = len(whose)
    laid = _laid(walls, pairs, count, whose, poses, 1.0, config)
    overlap = np.asarray(np.bincount(laid.hypothesis, laid.overlap, h), dtype=float)
    xx, xy, yy = (
        np.bincount(laid.hypothesis, laid.overlap * value, h)
        for value in (laid.n[:, 0] ** 2, laid.n[:, 0] * laid.n[:, 1], laid.n[:, 1] ** 2)
    )
    cross = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)
    # A wall counts once, and on the side of the direction to which it is nearer.
    main = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    along = (
        laid.n[:, 0] * np.cos(main)[laid.hypothesis] + laid.n[:, 1] * np.sin(main)[laid.hypothesis]
    )
    which, at = np.unique(np.column_stack((laid.hypothesis, laid.b)), axis=0, return_index=True)
    is_main = np.abs(along[at]) > np.sqrt(0.5)
    n_main = np.bincount(which[is_main, 0], minlength=h)
    n_cross = np.bincount(which[~is_main, 0], minlength=h)
    # Each wall is uneven as a whole: a wall of any length tells its offset once.
    information = _sums(
        laid.hypothesis, h, _rows(laid), np.full((len(laid.a), 2), 0.5 / config.sigma_wall**2)
    )
    return Evidence(overlap, cross, n_main + n_cross, np.minimum(n_main, n_cross), information)


def _laid(
    walls: Walls, pairs: Correspondences, count: int, whose: Index, poses: Array, reach: float,
    config: LoopConfig,
) -> _Laid:  # fmt: skip
    start = np.searchsorted(pairs.candidate, np.arange(count + 1))
    many = (start[1:] - start[:-1])[whose]
    h = np.repeat(np.arange(len(whose)), many)
    row = np.arange(len(h)) - (np.cumsum(many) - many)[h] + start[whose][h]
    a, b = pairs.a[row], pairs.b[row]
    keep = (
        np.abs(se2.wrap(walls.theta[a] - walls.theta[b] - poses[h, 2])) < reach * config.max_angle
    )
    h, a, b = h[keep], a[keep], b[keep]
    n, m = walls.normal[a], walls.normal[b]
    cos, sin = np.cos(poses[:, 2])[h], np.sin(poses[:, 2])[h]
    # Wall b in the frame of i: its foot, and its heading.
    foot_x = poses[h, 0] + walls.offset[b] * (cos * m[:, 0] - sin * m[:, 1])
    foot_y = poses[h, 1] + walls.offset[b] * (sin * m[:, 0] + cos * m[:, 1])
    u_x, u_y = cos * m[:, 1] + sin * m[:, 0], sin * m[:, 1] - cos * m[:, 0]
    slope = u_x * n[:, 1] - u_y * n[:, 0]  # nearly one: a and b are nearly parallel
    begin = foot_x * n[:, 1] - foot_y * n[:, 0]
    lo = np.maximum(walls.lo[b], (walls.lo[a] - begin) / slope)
    hi = np.minimum(walls.hi[b], (walls.hi[a] - begin) / slope)
    overlap = hi - lo
    at = np.stack((lo, hi), axis=1)
    ends = np.stack(
        (foot_x[:, None] + at * u_x[:, None], foot_y[:, None] + at * u_y[:, None]), axis=-1
    )
    across = (ends * n[:, None]).sum(axis=-1) - walls.offset[a][:, None]
    keep = (overlap > config.least_overlap) & (
        np.abs(across).max(axis=1) < reach * config.max_offset
    )
    return _Laid(h[keep], a[keep], b[keep], overlap[keep], ends[keep], across[keep], n[keep])


def _rows(laid: _Laid) -> Array:
    """d across / d delta of a step from the left, (n, 2, 3)."""
    n, q = laid.n[:, None], laid.ends
    lever = n[..., 1] * q[..., 0] - n[..., 0] * q[..., 1]
    return np.stack((*np.broadcast_arrays(n[..., 0], n[..., 1], lever),), axis=-1)


def _sums(hypothesis: Index, count: int, rows: Array, weight: Array) -> Array:
    """Sums over rows of `weight row^T row`, a matrix a hypothesis."""
    A = np.empty((count, 3, 3))
    for k in range(3):
        for m in range(k, 3):
            value = (weight * rows[..., k] * rows[..., m]).sum(axis=1)
            A[:, k, m] = A[:, m, k] = np.bincount(hypothesis, value, count)
    return A
