"""The environment level: area frames in g, from the crossings that join the areas (section 5.3).

Every crossing put the robot's pose into both areas as an *anchor*, and both anchors are one
place: `F_A X_a = F_B X_b`. Areas share no measurement, so their anchors' errors are independent
from area to area, and jointly Gaussian within one: all that the environment needs of an area is
the block of C(V) over its robot and anchors. Crossings that discover an area place it; every
further crossing is a constraint (equation 3 on the level of areas), by which anchors, frames,
and through their correlations all that the areas hold, are corrected.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.gaussian import symmetrise
from hiermap_cli.geometry import se2

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]


class Anchors(NamedTuple):
    """What the environment takes of an area.

    Poses (k, 3) in the area, the robot's first, then the anchors; covariance (3 k, 3 k) of their
    invariant errors.
    """

    poses: Array
    covariance: Array


class Link(NamedTuple):
    """One place in two areas: anchor `anchor_a` of area `a` is anchor `anchor_b` of area `b`.

    Indices into the list of areas, and into `Anchors.poses` of each.
    """

    a: int
    anchor_a: int
    b: int
    anchor_b: int


class Environment(NamedTuple):
    """frames: (K, 3) R_g_A.

    Anchors: corrected poses, one array an area. covariance: (N, N) of the invariant errors of all
    frames, then of all areas' robots and anchors, N = 3 K + sum 3 k.
    """

    frames: Array
    anchors: tuple[Array, ...]
    covariance: Array

    def frame_covariance(self, i: int) -> Array:
        """Invariant covariance (3, 3) of frame i in g."""
        return self.covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]

    def offset(self, area: int, anchor: int) -> int:
        """First component of an area's anchor (0 is its robot) in `covariance`."""
        before = sum(len(poses) for poses in self.anchors[:area])
        return 3 * (len(self.frames) + before + anchor)


def compose_environment(
    areas: Sequence[Anchors], links: Sequence[Link], start: Array, C_start: Array
) -> Environment:
    """Frames and joint covariance.

    `start`: (3,) R_g_A of the first area, C_start its covariance (invariant). Every area but the
    first is the `b` of the link that discovered it, and links are in the order of time; the others
    are constraints.
    """
    tree, loops = _tree(len(areas), links)
    sizes = [3 * len(a.poses) for a in areas]
    offsets = np.concatenate(([3], 3 + np.cumsum(sizes))).astype(int)
    P = np.zeros((offsets[-1], offsets[-1]))
    P[:3, :3] = C_start
    for area, at, size in zip(areas, offsets, sizes, strict=False):
        P[at : at + size, at : at + size] = area.covariance
    anchors = [a.poses for a in areas]
    root = np.asarray(start, dtype=float)
    if loops:
        anchors, root, P = _close(anchors, root, P, tree, loops, offsets)
    frames, M = _place(anchors, root, tree, offsets)
    return Environment(frames, tuple(anchors), _joint(M, P))


def _joint(M: Array, P: Array) -> Array:
    """The covariance of the frames, `M e`, and of the anchors, e less the root's error.

    Written block by block: for hundreds of areas each of these matrices is large.
    """
    MP = M @ P
    k = len(M)
    out = np.empty((k + len(P) - 3, k + len(P) - 3))
    out[:k, :k] = symmetrise(MP @ M.T)
    out[:k, k:] = MP[:, 3:]
    out[k:, :k] = MP[:, 3:].T
    out[k:, k:] = P[3:, 3:]
    return out


def _tree(areas: int, links: Sequence[Link]) -> tuple[list[Link], list[Link]]:
    """The links that place an area, each from an area placed before it, and all others.

    Links are taken in their order, but one that has no end in an area placed so far waits until
    it has: a fragment may be joined by an area that was discovered from it.
    """
    placed = {0}
    tree, loops, left = [], [], list(links)
    while left:
        waiting = []
        for link in left:
            if link.a not in placed and link.b not in placed:
                waiting.append(link)
            elif link.a in placed and link.b in placed:
                loops.append(link)
            else:
                back = Link(link.b, link.anchor_b, link.a, link.anchor_a)
                tree.append(link if link.a in placed else back)
                placed.add(tree[-1].b)
        if len(waiting) == len(left):
            break
        left = waiting
    if len(placed) != areas:
        raise AssertionError("an area that no crossing joins to the others")
    return tree, loops


def _place(
    anchors: Sequence[Array], root: Array, tree: Sequence[Link], offsets: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Frames (K, 3), and M (3 K, N) = d frames' errors / d (root, anchors' errors).

    `F_B = F_A X_a X_b^-1`, so `delta_B = delta_A + Ad(F_A) delta_a - Ad(F_B) delta_b`.
    """
    K = len(anchors)
    frames = np.zeros((K, 3))
    M = np.zeros((3 * K, offsets[-1]))
    frames[0] = root
    M[:3, :3] = np.eye(3)
    for link in tree:
        X_a, X_b = anchors[link.a][link.anchor_a], anchors[link.b][link.anchor_b]
        frames[link.b] = se2.compose(frames[link.a], se2.compose(X_a, se2.invert(X_b)))
        rows = slice(3 * link.b, 3 * link.b + 3)
        M[rows] = M[3 * link.a : 3 * link.a + 3]
        a, b = offsets[link.a] + 3 * link.anchor_a, offsets[link.b] + 3 * link.anchor_b
        M[rows, a : a + 3] += se2.adjoint(frames[link.a])
        M[rows, b : b + 3] -= se2.adjoint(frames[link.b])
    return frames, M


def _close(
    anchors: list[Array],
    root: Array,
    P: Array,
    tree: Sequence[Link],
    loops: Sequence[Link],
    offsets: NDArray[np.int64],
    rounds: int = 10,
) -> tuple[list[Array], Array, Array]:
    """Iterated constrained update: the anchors of least cost that satisfy every loop."""
    before = np.vstack([root[None], *anchors])
    now = before.copy()
    counts = np.cumsum([1, *[len(a) for a in anchors]])
    G = np.zeros((0, len(P)))
    for _ in range(rounds):
        split = [now[counts[i] : counts[i + 1]] for i in range(len(anchors))]
        frames, M = _place(split, now[0], tree, offsets)
        c, G = _loop_rows(loops, frames, split, M, offsets)
        # The step from the prior: e = -P G^T (G P G^T)^-1 (c - G e_now).
        e_now = se2.log(se2.compose(now, se2.invert(before))).ravel()
        gain = np.linalg.solve(G @ P @ G.T + 1e-12 * np.eye(len(c)), G @ P).T
        e = -gain @ (c - G @ e_now)
        now = se2.compose(se2.exp(e.reshape(-1, 3)), before)
        if np.abs(e - e_now).max() < 1e-10:
            break
    P = symmetrise(P - P @ G.T @ np.linalg.solve(G @ P @ G.T + 1e-12 * np.eye(len(G)), G @ P))
    return [now[counts[i] : counts[i + 1]] for i in range(len(anchors))], now[0], P


def _loop_rows(
    loops: Sequence[Link],
    frames: Array,
    anchors: Sequence[Array],
    M: Array,
    offsets: NDArray[np.int64],
) -> tuple[Array, Array]:
    """`c = log(A B^-1)` of the places A, B that each loop joins, (3 l,), and d c / d e (3 l, N)."""
    c, G = np.zeros(3 * len(loops)), np.zeros((3 * len(loops), M.shape[1]))
    for i, link in enumerate(loops):
        A = se2.compose(frames[link.a], anchors[link.a][link.anchor_a])
        B = se2.compose(frames[link.b], anchors[link.b][link.anchor_b])
        rows = slice(3 * i, 3 * i + 3)
        c[rows] = se2.log(se2.compose(A, se2.invert(B)))
        a, b = offsets[link.a] + 3 * link.anchor_a, offsets[link.b] + 3 * link.anchor_b
        G[rows] = M[3 * link.a : 3 * link.a + 3] - M[3 * link.b : 3 * link.b + 3]
        G[rows, a : a + 3] += se2.adjoint(frames[link.a])
        G[rows, b : b + 3] -= se2.adjoint(frames[link.b])
    return c, G


class LoopResidual(NamedTuple):
    """What a loop says against what was known before any loop was used.

    between: (3,) the place by way of area b, seen from the place by way of area a. nis: the
    normalised square of that error, a degree of freedom.
    """

    link: Link
    between: Array
    nis: float


def loop_residuals(
    areas: Sequence[Anchors], links: Sequence[Link], start: Array, C_start: Array
) -> list[LoopResidual]:
    """The residual of every loop, each alone; arguments as of `compose_environment`."""
    tree, loops = _tree(len(areas), links)
    if not loops:
        return []
    anchors = [a.poses for a in areas]
    offsets = np.concatenate(([3], 3 + np.cumsum([3 * len(a) for a in anchors]))).astype(int)
    frames, M = _place(anchors, np.asarray(start, dtype=float), tree, offsets)
    c, G = _loop_rows(loops, frames, anchors, M, offsets)
    out = []
    for i, link in enumerate(loops):
        rows = slice(3 * i, 3 * i + 3)
        S = G[rows, :3] @ C_start @ G[rows, :3].T
        for area, at in zip(areas, offsets, strict=False):
            H = G[rows, at : at + len(area.covariance)]
            S = S + H @ area.covariance @ H.T
        nis = float(c[rows] @ np.linalg.solve(S + 1e-12 * np.eye(3), c[rows])) / 3.0
        A = se2.compose(frames[link.a], anchors[link.a][link.anchor_a])
        B = se2.compose(frames[link.b], anchors[link.b][link.anchor_b])
        out.append(LoopResidual(link, se2.between(A, B), nis))
    return out
