"""The levels again, out of the solution: area maps, environment and trajectory.

Everything in the solution is known in g, with one joint covariance. The paper's levels are views
of it: an area is what was seen from within, in its own frame; its covariance is the marginal of
that, relative to the frame; the environment is the marginal of the frames and the robot.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.gaussian import symmetrise
from hiermap_cli.estimation.motion import PARAMETERS
from hiermap_cli.estimation.stochastic_map import StochasticMap
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import ANCHOR, END, WALL, AreaMap, Features
from hiermap_cli.mapping.refinement.problem import layout
from hiermap_cli.perception.segments import END_OPEN

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.mapping.keyscans import KeyScans
    from hiermap_cli.mapping.refinement.problem import Matched, State
    from hiermap_cli.mapping.refinement.smoothing import Solution

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]


class Sightings(NamedTuple):
    """What was seen from within one area.

    walls: (w,) numbers of walls, with how often, the last key scan, their reach lo and hi along
    them, and their uids in the area. ends, end_seen, end_last: the same of ends (e,).
    """

    walls: Index
    seen: Index
    last: Index
    lo: Array
    hi: Array
    uid: Index
    ends: Index
    end_seen: Index
    end_last: Index


def area_map(area: AreaMap, frame: int, robot: int, seen: Sightings, solution: Solution) -> AreaMap:
    """V and C(V) of an area out of the solution, in the frame of its first key scan.

    Args:
        area: as the filter left it: its anchors and their uids go on.
        frame: key scan at which its frame lies.
        robot: key scan at which the robot was last in it.
        seen: what it shows.
        solution: of the whole log.
    """
    state, where = solution.state, layout(solution.state)
    F = state.poses[frame]
    old = area.features
    anchors = np.flatnonzero(old.kind == ANCHOR)
    keys = np.concatenate(([robot], old.last[anchors]))
    Y_keys = se2.between(F, state.poses[keys])
    # Walls get their origin in the middle of what this area saw of them.
    middle = 0.5 * (seen.lo + seen.hi)
    W = se2.compose(state.walls.poses[seen.walls], _along(middle))
    Y_walls = se2.between(F, W)
    of_end = np.searchsorted(seen.walls, state.ends.wall[seen.ends])
    x = state.ends.x[seen.ends] - middle[of_end]
    Y_ends = se2.compose(Y_walls[of_end], _along(x))

    a, w, e = len(anchors), len(seen.walls), len(seen.ends)
    index = np.concatenate(
        (
            where.pose(keys).ravel(),
            where.parameters + np.arange(PARAMETERS),
            where.wall(seen.walls).ravel(),
            where.end(seen.ends).ravel(),
            where.pose(np.array([frame])).ravel(),
        )
    )
    n_keys, first_wall = 3 * (1 + a), 3 * (1 + a) + PARAMETERS
    first_end = first_wall + 2 * w
    of_frame = slice(first_end + e, first_end + e + 3)
    rows = _Rows(3 + PARAMETERS + 3 * (w + e + a), len(index))
    rows.pose(Y_keys[0], slice(0, 3), of_frame)
    rows.J[3 : 3 + PARAMETERS, n_keys:first_wall] = np.eye(PARAMETERS)
    rows.at = 3 + PARAMETERS
    for k in range(w):
        rows.wall(Y_walls[k], first_wall + 2 * k, middle[k], of_frame)
    for k in range(e):
        wall = int(of_end[k])
        rows.wall(Y_ends[k], first_wall + 2 * wall, middle[wall] + x[k], of_frame, first_end + k)
    for k in range(a):
        rows.pose(Y_keys[1 + k], slice(3 + 3 * k, 6 + 3 * k), of_frame)
    C = symmetrise(solution.factor.covariance(rows.J, index))
    for k in range(w):
        # Its place along itself is a convention, as large as it is long.
        at = 3 + PARAMETERS + 3 * k
        u = se2.adjoint(Y_walls[k])[:, 0]
        spread = max(0.5 * float(seen.hi[k] - seen.lo[k]), 0.5)
        C[at : at + 3, at : at + 3] += spread**2 * np.outer(u, u)
    poses = np.concatenate((Y_keys[:1], Y_walls, Y_ends, Y_keys[1:]))
    V = StochasticMap(poses, state.parameters.copy(), C, "invariant")
    if area.V.coordinates == "additive":
        T = np.eye(len(C))
        for i, block in enumerate(se2.additive_D_invariant(poses)):
            T[V.columns(i), V.columns(i)] = block
        V = StochasticMap(poses, V.parameters, symmetrise(T @ C @ T.T), "additive")
    uid_end = max(area.next_uid, int(seen.uid.max(initial=-1)) + 1)
    features = Features(
        uid=np.concatenate((seen.uid, uid_end + np.arange(e), old.uid[anchors])),
        kind=np.repeat([WALL, END, ANCHOR], [w, e, a]),
        wall=np.concatenate((np.full(w, -1), seen.uid[of_end], np.full(a, -1))),
        side=np.concatenate((np.zeros(w, np.int64), state.ends.side[seen.ends], old.side[anchors])),
        lo=np.concatenate((seen.lo - middle, np.zeros(e + a))),
        hi=np.concatenate((seen.hi - middle, np.zeros(e + a))),
        seen=np.concatenate((seen.seen, seen.end_seen, old.seen[anchors])),
        last=np.concatenate((seen.last, seen.end_last, old.last[anchors])),
    )
    return AreaMap(V, features, uid_end + e)


class _Rows:
    """Rows of d (errors of poses in the area) / d (variables), written one pose after another."""

    def __init__(self, rows: int, columns: int) -> None:
        self.J = np.zeros((rows, columns))
        self.at = 0

    def pose(self, Y: Array, own: slice, frame: slice) -> None:
        """A key scan's pose: `Ad(Y) xi - xi_frame`."""
        self.J[self.at : self.at + 3, own] += se2.adjoint(Y)
        self._finish(frame)

    def wall(self, Y: Array, own: int, along: float, frame: slice, end: int | None = None) -> None:
        """A place on a wall, `along` from the wall's origin; `end`: where its own x stands."""
        Ad = se2.adjoint(Y)
        self.J[self.at : self.at + 3, own] += Ad[:, 1]
        self.J[self.at : self.at + 3, own + 1] += Ad[:, 2] + along * Ad[:, 1]
        if end is not None:
            self.J[self.at : self.at + 3, end] += Ad[:, 0]
        self._finish(frame)

    def _finish(self, frame: slice) -> None:
        self.J[self.at : self.at + 3, frame] -= np.eye(3)
        self.at += 3


def sightings(
    area: int, keyscans: KeyScans, state: State, matched: Matched, next_uid: int, least: int
) -> Sightings:
    """What an area's own key scans show, as far as they show it `least` times."""
    s = keyscans.segments
    here = keyscans.area[s.scan[matched.segment]] == area
    segment, wall = matched.segment[here], matched.wall[here]
    count = np.bincount(wall, minlength=len(state.walls.poses))
    walls = np.flatnonzero(count >= least)
    number = np.full(len(count), -1)
    number[walls] = np.arange(len(walls))
    kept = number[wall] >= 0
    segment, wall, k = segment[kept], wall[kept], number[wall[kept]]
    W = state.walls.poses[wall]
    X = state.poses[s.scan[segment]]
    ends = [se2.compose(X, np.column_stack((s.ends[segment, i], X[:, 2])))[:, :2] for i in (0, 1)]
    t = np.column_stack((np.cos(W[:, 2]), np.sin(W[:, 2])))
    along = [np.einsum("ni,ni->n", t, point - W[:, :2]) for point in ends]
    # Beams that graze a wall leave its end open by metres: it reaches as far as it was hit.
    short = np.sqrt(3.0) * np.where(s.end_kind != END_OPEN, s.end_sigma, 0.0)[segment]
    short = np.minimum(short, 0.5 * s.length[segment, None])
    along = [along[0] + short[:, 0], along[1] - short[:, 1]]
    lo, hi = np.full(len(walls), np.inf), np.full(len(walls), -np.inf)
    np.minimum.at(lo, k, along[0])
    np.maximum.at(hi, k, along[1])
    last = np.zeros(len(walls), dtype=np.int64)
    np.maximum.at(last, k, s.scan[segment])

    here = keyscans.area[s.scan[matched.end_segment]] == area
    end, scan = matched.end[here], s.scan[matched.end_segment[here]]
    end_count = np.bincount(end, minlength=len(state.ends.x))
    end_last = np.zeros(len(end_count), dtype=np.int64)
    np.maximum.at(end_last, end, scan)
    ends_here = np.flatnonzero((end_count >= least) & (number[state.ends.wall] >= 0))
    return Sightings(
        walls, count[walls], last, lo, hi, _uids(s.wall[segment], k, len(walls), next_uid),
        ends_here, end_count[ends_here], end_last[ends_here],
    )  # fmt: skip


def _uids(by_filter: Index, wall: Index, walls: int, next_uid: int) -> Index:
    """Uids of walls 0.. by those that the filter gave their segments (-1: none).

    A uid goes to the wall to which most of its segments went, if it also is that wall's most
    frequent one; other walls get new ones.
    """
    uid = next_uid + np.arange(walls)
    known = by_filter >= 0
    pairs, count = np.unique(
        np.column_stack((by_filter[known], wall[known])), axis=0, return_counts=True
    )
    of_uid: dict[int, int] = {}
    of_wall: dict[int, int] = {}
    order = np.lexsort((pairs[:, 1], pairs[:, 0], -count))
    for u, k in pairs[order].tolist():
        if u not in of_uid and k not in of_wall:
            of_uid[u], of_wall[k] = k, u
    for k, u in of_wall.items():
        uid[k] = u
    return uid


def _along(x: Array) -> Array:
    return np.column_stack((x, np.zeros(len(x)), np.zeros(len(x))))
