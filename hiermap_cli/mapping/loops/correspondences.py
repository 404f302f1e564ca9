"""Which walls of two fragments may be the same, as far as their places are known."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LoopConfig
    from hiermap_cli.mapping.loops.fragments import Walls

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]


class Candidates(NamedTuple):
    """P pairs of fragments that may have seen the same.

    i, j: (P,) fragments. R_i_j: (P, 3) as far as it is known. C_i_j: (P, 3, 3) covariance of
    `log(R_i_j R_i_j_hat^-1)`, which is in the frame of i.
    """

    i: Index
    j: Index
    R_i_j: Array
    C_i_j: Array

    def rows(self, which: Index | Mask | slice) -> Candidates:
        """Some of them."""
        return Candidates._make(column[which] for column in self)


class Correspondences(NamedTuple):
    """Walls that may be the same: candidate (n,), wall a of its i (n,), wall b of its j (n,)."""

    candidate: Index
    a: Index
    b: Index


def ragged(count: Index) -> tuple[Index, Index]:
    """Rows of a ragged table laid flat: whose each row is, and its number there."""
    whose = np.repeat(np.arange(len(count)), count)
    start = np.cumsum(count) - count
    return whose, np.arange(len(whose)) - start[whose]


def correspondences(walls: Walls, candidates: Candidates, config: LoopConfig) -> Correspondences:
    """All walls that the prior lets be the same."""
    i, j = candidates.i, candidates.j
    n_i, n_j = walls.start[i + 1] - walls.start[i], walls.start[j + 1] - walls.start[j]
    p, row = ragged(n_i * n_j)
    a, b = walls.start[i][p] + row // n_j[p], walls.start[j][p] + row % n_j[p]
    R, C = candidates.R_i_j, candidates.C_i_j
    sigmas = config.window_sigmas
    turn = config.max_angle + np.minimum(sigmas * np.sqrt(C[:, 2, 2]), config.max_turn)
    keep = np.abs(se2.wrap(walls.theta[a] - walls.theta[b] - R[p, 2])) < turn[p]
    p, a, b = p[keep], a[keep], b[keep]
    # The middle of b at the prior, and how far it may move across and along a.
    middle = 0.5 * (walls.lo + walls.hi)
    u_b = np.column_stack((walls.normal[b, 1], -walls.normal[b, 0]))
    q = u_b * middle[b, None] + walls.normal[b] * walls.offset[b, None]
    cos, sin = np.cos(R[p, 2]), np.sin(R[p, 2])
    x = R[p, 0] + cos * q[:, 0] - sin * q[:, 1]
    y = R[p, 1] + sin * q[:, 0] + cos * q[:, 1]
    n = walls.normal[a]
    across = n[:, 0] * x + n[:, 1] * y - walls.offset[a]
    along = n[:, 1] * x - n[:, 0] * y - middle[a]
    free = sigmas * np.sqrt(_variance(C[p], n, x, y))
    keep = np.abs(across) < config.max_offset + free + 0.5 * walls.length[b] * np.sin(turn[p])
    u = np.column_stack((n[:, 1], -n[:, 0]))
    free = sigmas * np.sqrt(_variance(C[p], u, x, y))
    keep &= np.abs(along) < 0.5 * (walls.length[a] + walls.length[b]) + free
    return Correspondences(p[keep], a[keep], b[keep])


def _variance(C: Array, n: Array, x: Array, y: Array) -> Array:
    """Of where points (x, y) lie along directions n (m, 2), by invariant covariances (m, 3, 3)."""
    row = np.stack((n[:, 0], n[:, 1], n[:, 1] * x - n[:, 0] * y), axis=-1)
    return np.asarray(np.maximum(np.einsum("mi,mij,mj->m", row, C, row), 0.0))
