"""The path cut into fragments of a few metres, each with the walls that were seen on it.

Over some metres of path the filter's poses are true to a few centimetres, whatever has become of
them over the whole log (design, section 8.4). So the path is cut into fragments that are stiff:
the robot's poses relative to each other are kept, and every segment of the fragment's key scans
is merged into its lines. What is not known is how the fragments lie to each other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LoopConfig
    from hiermap_cli.mapping.keyscans import KeyScans

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

LEAST_KEYS = 4  # key scans between broken steps that cut the path
GLANCE = 4.0  # metres along a wall that are seen well, for each metre off it
MAX_ROUNDS = 60  # lines of a fragment: what is still left then is clutter


class Walls(NamedTuple):
    """The W walls of all fragments, by fragment and the longer ones first, in their frames.

    fragment: (W,). theta: (W,) heading, the free side on the left. normal: (W, 2) unit, to the
    free side. offset: (W,) of the line along the normal. lo, hi: (W,) extent along the heading,
    from the foot of the fragment's origin. length: (W,) of the extent that was seen. seen: (W,)
    key scans. start: (F + 1,) the first wall of each fragment.
    """

    fragment: Index
    theta: Array
    normal: Array
    offset: Array
    lo: Array
    hi: Array
    length: Array
    seen: Index
    start: Index


class Fragments(NamedTuple):
    """F fragments of K key scans.

    first: (F + 1,) the first key scan of each. centre: (F,) the key scan whose pose is the
    fragment's frame. of_key: (K,). R_f_k: (K, 3) the key scans in the frames of their fragments.
    points: (S, 2, 2) the ends of all segments, likewise, and scan: (S,) the segments' key scans.
    walls: what was seen. solid: as much of it as was not seen at a glance only, at which an open
    door looks like a wall.
    """

    first: Index
    centre: Index
    of_key: Index
    R_f_k: Array
    points: Array
    scan: Index
    walls: Walls
    solid: Walls


def cut_path(poses: Array, broken: Mask, config: LoopConfig) -> Index:
    """The first key scan of each fragment and K behind them: (F + 1,).

    A fragment ends after its length of path, and at a step that is `broken` (K,): whether the
    filter found itself again there is not to be taken for granted. Of broken steps that follow
    each other closely the first one cuts: single scans tell nothing.
    """
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    path = np.concatenate(([0.0], np.cumsum(steps)))
    cuts = [0]
    for k in np.flatnonzero(broken).tolist():
        if k - cuts[-1] >= LEAST_KEYS:
            cuts.append(k)
    bounds = np.array([*cuts, len(poses)])
    first: list[int] = []
    for a, b in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        # Equal parts, so that no remainder is left that sees nothing.
        parts = max(1, round((path[b - 1] - path[a]) / config.fragment_path))
        at = path[a] + (path[b - 1] - path[a]) * np.arange(parts) / parts
        first += (a + np.unique(np.searchsorted(path[a:b], at - 1e-9))).tolist()
    return np.array([*sorted(set(first)), len(poses)], dtype=np.int64)


def fragments_of(keyscans: KeyScans, poses: Array, broken: Mask, config: LoopConfig) -> Fragments:
    """Cuts the path of (K, 3) poses in any one frame, and merges what was seen on it."""
    first = cut_path(poses, broken, config)
    n = len(first) - 1
    centre = (first[:-1] + first[1:]) // 2
    of_key = np.repeat(np.arange(n), np.diff(first))
    R_f_k = se2.between(poses[centre[of_key]], poses)
    s = keyscans.segments
    pose = R_f_k[s.scan]
    turn = se2.rotation(pose[:, 2])
    points = pose[:, None, :2] + np.einsum("nij,nkj->nki", turn, s.ends)
    middle = pose[:, :2] + np.einsum("nij,nj->ni", turn, s.centre)
    theta = se2.wrap(pose[:, 2] + s.theta)
    where = of_key[s.scan]
    line_of, lines = _lines(where, middle, theta, points, s.length, config)
    used = np.flatnonzero(line_of >= 0)
    line = line_of[used]
    t = lines[line, 2]
    u = np.column_stack((np.cos(t), np.sin(t)))
    along = np.sort((points[used] * u[:, None]).sum(axis=-1), axis=1)
    # How far off the line the robot was, and where along it.
    off = pose[used, :2] - lines[line, :2]
    depth = GLANCE * np.abs(u[:, 0] * off[:, 1] - u[:, 1] * off[:, 0])
    abreast = (pose[used, :2] * u).sum(axis=1)
    near = np.clip(along, (abreast - depth)[:, None], (abreast + depth)[:, None])
    walls, solid = (
        _runs(_Pieces(where[used], s.scan[used], line, *part.T), lines, n, config)
        for part in (along, near)
    )
    return Fragments(first, centre, of_key, R_f_k, points, s.scan, walls, solid)


class _Pieces(NamedTuple):
    """Pieces of lines that were seen, (n,) each: fragment, scan, line, and from where to where."""

    fragment: Index
    scan: Index
    line: Index
    lo: Array
    hi: Array


def _lines(
    fragment: Index, centre: Array, theta: Array, points: Array, length: Array, config: LoopConfig
) -> tuple[Index, Array]:
    """Segments on common lines: the longest one left leads, those on its line follow.

    All fragments take one line a round, so that the rounds are as many as a fragment has lines.
    Returns the line (S,) of each segment, -1 for none, and the lines' [x, y, theta] (n, 3).
    """
    left = np.flatnonzero(length >= config.min_segment)
    left = left[np.lexsort((left, -length[left], fragment[left]))]
    line_of = np.full(len(length), -1, dtype=np.int64)
    lines: list[Array] = []
    known = 0
    for _ in range(MAX_ROUNDS):
        if not len(left):
            break
        head = np.flatnonzero(np.diff(fragment[left], prepend=-1))
        group = np.repeat(np.arange(len(head)), np.diff(head, append=len(left)))
        c, t = centre[left[head]], theta[left[head]]
        on = np.zeros(len(left), dtype=bool)
        for _ in range(2):
            on = _on_line(c[group], t[group], theta[left], points[left], config)
            on[head] = True
            where = left[on]
            c, t = _refit(group[on], len(head), c, t, centre[where], theta[where], length[where])
        line_of[left[on]] = known + group[on]
        lines.append(np.column_stack((c, t)))
        known += len(head)
        left = left[~on]
    return line_of, np.concatenate(lines) if lines else np.zeros((0, 3))


def _on_line(c: Array, t: Array, theta: Array, points: Array, config: LoopConfig) -> Mask:
    """Which segments lie on the lines through c (n, 2) with headings t (n,)."""
    on: Mask = np.abs(se2.wrap(theta - t)) < config.merge_angle
    k = np.flatnonzero(on)
    sin, cos = np.sin(t[k])[:, None], np.cos(t[k])[:, None]
    off = points[k] - c[k, None]
    across = cos * off[..., 1] - sin * off[..., 0]
    on[k] = (np.abs(across) < config.merge_offset).all(axis=1)
    return on


def _refit(
    group: Index, n: int, c: Array, t: Array, centre: Array, theta: Array, length: Array
) -> tuple[Array, Array]:
    """Lines of least squares through segments, each a uniform piece of its line."""
    u = np.stack((np.cos(t), np.sin(t)), axis=-1)[group]
    d = centre - c[group]
    x = (d * u).sum(axis=1)
    y = d[:, 1] * u[:, 0] - d[:, 0] * u[:, 1]

    def total(value: Array) -> Array:
        return np.asarray(np.bincount(group, length * value, n), dtype=float)

    weight = total(np.ones(len(x)))
    mean_x, mean_y = total(x) / weight, total(y) / weight
    inner = np.square(length) / 12.0
    s_xx = total(np.square(x) + inner) - weight * np.square(mean_x)
    s_xy = total(x * y + inner * np.sin(theta - t[group])) - weight * mean_x * mean_y
    slope = s_xy / np.maximum(s_xx, 1e-9)
    cos, sin = np.cos(t), np.sin(t)
    moved = c + np.column_stack((cos * mean_x - sin * mean_y, sin * mean_x + cos * mean_y))
    return moved, se2.wrap(t + np.arctan(slope))


def _runs(pieces: _Pieces, lines: Array, count: int, config: LoopConfig) -> Walls:
    """The lines cut where nothing was seen of them: a door is no wall."""
    order = np.lexsort((pieces.lo, pieces.line))
    fragment, scan, line = pieces.fragment[order], pieces.scan[order], pieces.line[order]
    lo, hi = pieces.lo[order], pieces.hi[order]
    # The farthest end so far on the same line: lines are set far apart from each other.
    apart = 1e4 * line
    farthest = np.maximum.accumulate(hi + apart) - apart
    new = np.ones(len(line), dtype=bool)
    new[1:] = (line[1:] != line[:-1]) | (lo[1:] > farthest[:-1] + config.merge_gap)
    head = np.flatnonzero(new)
    wall = np.cumsum(new) - 1
    n = len(head)
    if not n:
        empty, none = np.zeros(0), np.zeros(0, dtype=np.int64)
        return Walls(
            none, empty, np.zeros((0, 2)), empty, empty, empty, empty, none,
            np.zeros(count + 1, dtype=np.int64),
        )  # fmt: skip
    low, high = lo[head], np.maximum.reduceat(hi, head)
    pairs = np.unique(np.column_stack((wall, scan)), axis=0)
    seen = np.bincount(pairs[:, 0], minlength=n)
    whose = fragment[head]
    t = lines[line[head], 2]
    normal = np.column_stack((-np.sin(t), np.cos(t)))
    offset = (lines[line[head], :2] * normal).sum(axis=1)
    extent = high - low
    # Seen once and short is what walks about, or clutter.
    once = (seen < 2) & (extent < config.min_once)
    keep = np.flatnonzero((extent >= config.min_wall) & ~once)
    keep = keep[np.lexsort((keep, -extent[keep], whose[keep]))]
    return Walls(
        whose[keep], t[keep], normal[keep], offset[keep], low[keep], high[keep], extent[keep],
        seen[keep], np.searchsorted(whose[keep], np.arange(count + 1)),
    )  # fmt: skip
