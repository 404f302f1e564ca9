"""Could what was seen here have been seen there? Two grids of free space laid on each other.

Walls alone do not tell where in a corridor a robot is, nor in which of a row of rooms: the long
walls that fit outweigh the doors that do not. So it is asked, cell by cell, what speaks against a
place: where beams ended here and passed there, or passed here and ended there. Of the true place
next to nothing does, and what people hid is soon passed by other beams.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import raster, se2
from hiermap_cli.mapping.association.relocation import area_lines, explained_length
from hiermap_cli.mapping.topology.freespace import CELL, FreeGrid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import Config, RelocationConfig
    from hiermap_cli.mapping.area_map import AreaMap
    from hiermap_cli.mapping.association.relocation import Lines
    from hiermap_cli.mapping.topology.trace import Trace
    from hiermap_cli.perception.sight import Sight
    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

ON, OFF = 1.5, 2.5  # cells from an end within which it is the same, and beyond which it is not
FIT_ANGLE, FIT_OFFSET, ROUNDS = 0.12, 0.3, 3  # between walls that are laid on each other
LEAST_ENDED = 2  # scans that ended in a cell: once is what walks about
APART, ALONG = 6, 100  # cells along the walls to another place, and to the farthest one asked for
TURNED = np.array([0.0, 0.0, np.pi])


class Seen(NamedTuple):
    """What was seen of a place, in the frame of its area.

    ends: (m, 2) centres of cells in which beams ended. near: cells near one, free: cells that
    beams passed, far from all; both (w, h), first: index of their first cell.
    """

    ends: Array
    near: Mask
    free: Mask
    first: tuple[int, int]

    def at(self, points: Array) -> tuple[Mask, Mask]:
        """Which of the points (..., 2) are near an end, and which where nothing ends."""
        i = np.floor(points / CELL).astype(np.int64) - self.first
        w, h = self.near.shape
        known = (i >= 0).all(axis=-1) & (i[..., 0] < w) & (i[..., 1] < h)
        x, y = np.where(known, i[..., 0], 0), np.where(known, i[..., 1], 0)
        return known & self.near[x, y], known & self.free[x, y]


class Comparison(NamedTuple):
    """Of P poses: share (P,) of the ends here that are ends there; against: (P,) of all judged."""

    share: Array
    against: Array


def seen(grid: FreeGrid) -> Seen:
    """What the grid of an area tells."""
    if not grid.passed.size:
        empty = np.zeros((1, 1), dtype=bool)
        return Seen(np.zeros((0, 2)), empty, empty, (0, 0))
    free = grid.free()
    ended = (grid.ended >= LEAST_ENDED) & ~free
    cells = np.argwhere(ended) + grid.first
    any_end = (grid.ended > 0) & ~free
    return Seen(
        np.asarray(CELL * (cells + 0.5), dtype=float),
        raster.grown(ended, ON),
        free & ~raster.grown(any_end, OFF),
        grid.first,
    )


def seen_lately(trace: Trace) -> Seen:
    """What was seen over the last metres of the path, since the present area was entered."""
    grid = FreeGrid()
    for travelled, origin, ends in zip(trace.travelled, trace.origins, trace.ends, strict=True):
        if travelled >= trace.entered:
            grid.add(origin, ends)
    return seen(grid)


def compared(here: Seen, there: Seen, R_t_h: Array) -> Comparison:
    """How two places agree where this one lies in the other as R_t_h, (P, 3)."""
    share, against = np.zeros(len(R_t_h)), np.ones(len(R_t_h))
    if not len(here.ends) or not len(there.ends):
        return Comparison(share, against)
    for p, R in enumerate(R_t_h):
        agree, wrong = there.at(_moved(R, here.ends))
        _, back = here.at(_moved(se2.invert(R), there.ends))
        n, bad = int(agree.sum()), int(wrong.sum()) + int(back.sum())
        share[p] = n / len(here.ends)
        against[p] = bad / max(n + bad, 1)
    return Comparison(share, against)


def farther_along(
    believed: Array,
    sight: Sight,
    view: SegmentView,
    area: AreaMap,
    there: Seen,
    config: Config,
) -> bool:
    """Whether a scan, taken where the robot stands, shows a place farther along the walls.

    Along a corridor the walls are the same wherever the robot is, whichever way it faces. It is
    elsewhere where what was seen of the area, `there`, contradicts the scan as taken at `believed`
    (3,), and does not as taken somewhere else on the line of the longest wall. Neither people nor
    ground that is new show such a place.
    """
    c = config.lost
    if not len(view.length):
        return False
    grid = FreeGrid()
    for _ in range(LEAST_ENDED):  # it stands: what it sees now it sees again
        grid.add(sight.origin, sight.ends)
    start = np.array([believed, se2.compose(believed, TURNED)])
    lines = area_lines(area, config.relocation.least_seen)
    if len(lines.theta):
        start = settled(lines, view, start, config.relocation)
    along = start[:, 2] + float(view.theta[int(view.length.argmax())])
    steps = CELL * np.arange(-ALONG, ALONG + 1)
    poses = np.repeat(start, len(steps), axis=0)
    poses[:, 0] += np.outer(np.cos(along), steps).ravel()
    poses[:, 1] += np.outer(np.sin(along), steps).ravel()
    here = seen(grid)
    stays = float(compared(here, there, start[:1]).against[0])
    if stays <= c.max_against:
        return False
    share, against = compared(here, there, poses)
    against[share <= c.min_seen] = 1.0
    against[ALONG - APART : ALONG + APART + 1] = 1.0  # facing as it does: no other place
    best = float(against.min())
    return best <= c.max_against and stays >= c.clear * max(best, c.floor)


def settled(lines: Lines, view: SegmentView, poses: Array, config: RelocationConfig) -> Array:
    """Poses (P, 3) of the view, each brought to where its segments lie best on the lines.

    Gauss-Newton on the distances of the segments' ends, each from the line that is nearest.
    """
    out = poses.copy()
    ends = view.ends.reshape(-1, 2)
    weight = np.repeat(np.sqrt(view.length), 2)
    direction = np.column_stack((lines.normal[:, 1], -lines.normal[:, 0]))
    for p in range(len(out)):
        for _ in range(ROUNDS):
            points = _moved(out[p], ends)
            across = (points @ lines.normal.T - lines.offset).reshape(-1, 2, len(lines.theta))
            along = (points @ direction.T).reshape(across.shape)
            overlap = np.minimum(along.max(axis=1), lines.hi) - np.maximum(
                along.min(axis=1), lines.lo
            )
            turn = np.abs(se2.wrap(view.theta[:, None] + out[p, 2] - lines.theta))
            off = np.abs(across).max(axis=1)
            fits = (turn < FIT_ANGLE) & (off < FIT_OFFSET)
            fits &= overlap > 0.3 * view.length[:, None]
            off = np.where(fits, off, np.inf)
            line = off.argmin(axis=1)
            used = np.isfinite(off[np.arange(len(line)), line])
            row = np.repeat(used, 2)
            which = np.repeat(line, 2)[row]
            if np.count_nonzero(used) < 2:
                break
            n, at = lines.normal[which], points[row] - out[p, :2]
            J = np.column_stack((n, n[:, 1] * at[:, 0] - n[:, 0] * at[:, 1]))
            r = (points[row] * n).sum(axis=1) - lines.offset[which]
            w = weight[row]
            H = (J * w[:, None] ** 2).T @ J + np.diag((1e-3, 1e-3, 1e-3))
            out[p] -= np.linalg.solve(H, J.T @ (w**2 * r))
    out[:, 2] = se2.wrap(out[:, 2])
    better = explained_length(lines, view, out, config) >= explained_length(
        lines, view, poses, config
    )
    return np.asarray(np.where(better[:, None], out, poses))


def _moved(R: Array, points: Array) -> Array:
    """Points (n, 2) seen through R (3,)."""
    c, s = np.cos(R[2]), np.sin(R[2])
    return np.asarray(R[:2] + points @ np.array([[c, s], [-s, c]]))
