"""Which wall of the area is each segment of a scan, and which of its ends each end."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.association import (
    Candidates,
    chi_square,
    joint_compatibility,
    without_the_worst,
)
from hiermap_cli.estimation.stochastic_map import Constraint, prepare
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import (
    END,
    WALL,
    Frames,
    Matches,
    innovations,
    match_noise,
    match_rows,
    seen_frames,
    wall_noise,
)
from hiermap_cli.perception.segments import END_OPEN

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import AssociationConfig, FilterConfig
    from hiermap_cli.estimation.stochastic_map import StochasticMap
    from hiermap_cli.mapping.area_map import AreaMap
    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

_NONE = np.zeros(0, dtype=np.int64)
MAX_SEGMENTS, MAX_CANDIDATES = 10, 3


class Association(NamedTuple):
    """matches: what was found, and `constraint`: its rows, ready.

    Near: (s,) whether a segment lies near enough to some wall that it must not found a new one.
    offered: how many segments could have been matched.
    """

    matches: Matches
    constraint: Constraint | None
    near: NDArray[np.bool_]
    offered: int


class Pairs(NamedTuple):
    """Segments against walls that passed their own gates, by segment, best first, c pairs."""

    segment: Index
    wall: Index
    cost: Array


def associate(
    area: AreaMap, view: SegmentView, config: AssociationConfig, filter_config: FilterConfig
) -> Association:
    """Segments to walls by joint compatibility, then their ends to the ends of those walls."""
    V = area.V
    frames = seen_frames(V)
    pairs = wall_pairs(area, frames, view, config, filter_config.min_match_length)
    near = np.zeros(len(view.length), dtype=bool)
    near[pairs.segment] = True
    offered = int(np.count_nonzero(view.length >= filter_config.min_match_length))
    if not len(pairs.segment):
        return Association(Matches(_NONE, _NONE, _NONE, _NONE, _NONE), None, near, offered)
    tried = _tried(pairs, view)
    best = _best(tried.segment)
    ends = _end_candidates(area, view, tried.segment[best], tried.wall[best])
    # The best pair of every segment and all candidate ends, linearised once: nearly always all
    # of these pairs hold together.
    constraint, matches = _prepared(V, frames, view, tried.segment[best], tried.wall[best], ends)
    k = 2 * len(best)
    z = constraint.gain.whiten(constraint.innovation)[:k]
    d2 = float(z @ z)
    if d2 > chi_square(config.gate, k):
        best = _jointly_compatible(V, frames, view, tried, config)
        ends = _end_candidates(area, view, tried.segment[best], tried.wall[best])
        constraint, matches = _prepared(
            V, frames, view, tried.segment[best], tried.wall[best], ends
        )
    return _with_ends(constraint, matches, near, offered, config)


def wall_pairs(
    area: AreaMap,
    frames: Frames,
    view: SegmentView,
    config: AssociationConfig,
    min_length: float,
) -> Pairs:
    """Pairs within angle, offset and extent, gated by chi-square with 2 degrees of freedom.

    Segment and wall are compared as each lies to the robot: by its distance from the robot and
    its reach along itself from the foot of the perpendicular, which an error of the robot's
    heading does not change.
    """
    f = area.features
    walls = (f.kind == WALL).nonzero()[0]
    segments = (view.length >= min_length).nonzero()[0]
    none = Pairs(_NONE, _NONE, np.zeros(0))
    if not len(walls) or not len(segments):
        return none
    F = frames.select(walls)
    foot, aside = F.cos * F.x + F.sin * F.y, F.sin * F.x - F.cos * F.y
    theta = view.theta[segments]
    c, s = np.cos(theta), np.sin(theta)
    centre, ends = view.centre[segments], view.ends[segments]
    along = c[:, None] * ends[..., 0] + s[:, None] * ends[..., 1]
    offset = s * centre[:, 0] - c * centre[:, 1]
    gap = np.maximum(foot + f.lo[walls] - along[:, 1:], along[:, :1] - (foot + f.hi[walls]))
    i, j = np.nonzero(
        (np.cos(theta[:, None] - F.theta) > math.cos(config.max_angle))
        & (np.abs(offset[:, None] - aside) < config.max_offset)
        & (gap < config.max_gap)
    )
    if not len(i):
        return none
    segment, wall = segments[i], walls[j]
    distance, log_det = _pair_distances(area.V, frames.select(wall), view, segment, wall)
    good = distance < chi_square(config.gate, 2)
    segment, wall = segment[good], wall[good]
    overlap = -gap[i, j][good] / view.length[segment]
    overlap = np.minimum(np.maximum(overlap, -1.0), 1.0)
    cost = distance[good] + log_det[good] - config.overlap_bonus * overlap
    order = np.lexsort((cost, segment))
    return Pairs(segment[order], wall[order], cost[order])


def _pair_distances(
    V: StochasticMap, frames: Frames, view: SegmentView, segment: Index, wall: Index
) -> tuple[Array, Array]:
    """Squared Mahalanobis distance and log det S of each pair's (y, theta) innovation.

    The laser's x error is left out of S here: it only ranks and gates single pairs, and is in
    the joint test that decides.
    """
    matches = Matches(segment, wall, _NONE, _NONE, _NONE)
    rows = match_rows(V, frames, view, matches)
    nu_y, nu_t = rows.innovation[0::2], rows.innovation[1::2]
    P = V.covariance
    columns = V.first_object + 3 * wall[:, None] + np.arange(3)
    P_ll = P[columns[:, :, None], columns[:, None, :]]
    P_lr = P[columns[:, :, None], np.arange(3)]
    P_rr = P[:3, :3]
    if V.coordinates == "additive":
        T_l, T_r = se2.invariant_D_additive(V.poses[1 + wall]), se2.invariant_D_additive(V.robot)
        P_ll, P_lr = T_l @ P_ll @ T_l.transpose(0, 2, 1), T_l @ P_lr @ T_r.T
        P_rr = T_r @ P_rr @ T_r.T
    relative = P_rr + P_ll - P_lr - P_lr.transpose(0, 2, 1)
    H = rows.H_object.reshape(-1, 2, 3)
    S = H @ relative @ H.transpose(0, 2, 1)
    R_yy, R_yt, R_tt = wall_noise(frames, view, segment)
    S_yy, S_yt, S_tt = S[:, 0, 0] + R_yy, S[:, 0, 1] + R_yt, S[:, 1, 1] + R_tt
    det = S_yy * S_tt - S_yt**2
    d2 = (S_tt * nu_y**2 - 2.0 * S_yt * nu_y * nu_t + S_yy * nu_t**2) / det
    return d2, np.log(det)


def _tried(pairs: Pairs, view: SegmentView) -> Pairs:
    """The best few candidates of the longest segments."""
    first = _best(pairs.segment)
    if len(first) == len(pairs.segment) <= MAX_SEGMENTS:
        return pairs
    counts = np.diff(np.append(first, len(pairs.segment)))
    rank = np.arange(len(pairs.segment)) - np.repeat(first, counts)
    keep = rank < MAX_CANDIDATES
    longest = pairs.segment[first]
    if len(longest) > MAX_SEGMENTS:
        order = np.argsort(-view.length[longest], kind="stable")
        keep &= np.isin(pairs.segment, longest[order[:MAX_SEGMENTS]])
    if keep.all():
        return pairs
    return Pairs._make(column[keep] for column in pairs)


def _best(segment: Index) -> Index:
    """Where each segment's run begins in a list sorted by segment: its best candidate."""
    new = np.empty(len(segment), dtype=bool)
    new[:1] = True
    np.not_equal(segment[1:], segment[:-1], out=new[1:])
    return new.nonzero()[0]


def _jointly_compatible(
    V: StochasticMap, frames: Frames, view: SegmentView, tried: Pairs, config: AssociationConfig
) -> Index:
    """The best pairs less one in four at most that spoil them, else branch and bound over all."""
    matches = Matches(tried.segment, tried.wall, _NONE, _NONE, _NONE)
    F = frames.select(tried.wall)
    S = prepare(V, match_rows(V, F, view, matches), match_noise(F, view, matches)).gain.S
    innovation = innovations(F, view, matches).reshape(-1, 2)
    candidates = Candidates(tried.segment, tried.wall, tried.cost, innovation, S)
    best = _best(tried.segment).tolist()
    kept = without_the_worst(candidates, best, config.gate, len(best) // 4)
    if kept is not None:
        return np.array(kept, dtype=np.int64)
    return np.array(joint_compatibility(candidates, config.gate), dtype=np.int64)


def _end_candidates(area: AreaMap, view: SegmentView, segment: Index, wall: Index) -> Matches:
    """All pairs of an end of a matched segment with a known end of the same wall and side."""
    f = area.features
    i, side = np.nonzero(view.end_kind[segment] != END_OPEN)
    # An end's wall and side in one number, to be compared at once.
    known = np.where(f.kind == END, 2 * f.wall + f.side, -1)
    a, b = np.nonzero(known == (2 * f.uid[wall[i]] + side[:, None].T).T)
    return Matches(segment, wall, segment[i[a]], side[a], b)


def _prepared(
    V: StochasticMap, frames: Frames, view: SegmentView, segment: Index, wall: Index, ends: Matches
) -> tuple[Constraint, Matches]:
    matches = ends._replace(segment=segment, wall=wall)
    F = frames.select(np.concatenate((wall, matches.end)))
    rows = match_rows(V, F, view, matches)
    return prepare(V, rows, match_noise(F, view, matches)), matches


def _with_ends(
    constraint: Constraint,
    matches: Matches,
    near: NDArray[np.bool_],
    offered: int,
    config: AssociationConfig,
) -> Association:
    """Keep of the candidate ends the nearest of each, one to one, within their gate."""
    a = len(matches.wall)
    if len(matches.end):
        d2 = constraint.innovation[2 * a :] ** 2 / np.diagonal(constraint.gain.S)[2 * a :]
        gate = chi_square(config.gate, 1)
        ends = (2 * matches.end_segment + matches.end_side).tolist()
        taken: set[int] = set()
        keep = []
        for k in np.argsort(d2, kind="stable").tolist():
            if d2[k] > gate:
                break
            end, known = ends[k], -1 - int(matches.end[k])
            if end not in taken and known not in taken:
                taken.update((end, known))
                keep.append(k)
        if len(keep) < len(matches.end):
            kept = np.sort(np.array(keep, dtype=np.int64))
            constraint = constraint.select(np.concatenate((np.arange(2 * a), 2 * a + kept)))
            matches = matches._replace(
                end_segment=matches.end_segment[kept],
                end_side=matches.end_side[kept],
                end=matches.end[kept],
            )
    return Association(matches, constraint, near, offered)
