"""Which wall of the area is each segment of a scan, and which of its ends each end."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.association import Candidates, chi_square, joint_compatibility
from hiermap_cli.estimation.gaussian import gain
from hiermap_cli.estimation.stochastic_map import jacobian
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import END, WALL, Matches, match_noise, match_rows, measuring_pose
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
    """matches: what was found. near: (s,) whether a segment lies near enough to some wall that
    it must not found a new one. offered: how many segments could have been matched."""

    matches: Matches
    near: NDArray[np.bool_]
    offered: int


class Pairs(NamedTuple):
    """Segments against walls, in each wall's frame: c pairs that passed the coarse gates."""

    segment: Index
    wall: Index
    cost: Array
    distance: Array


def wall_pairs(
    area: AreaMap, view: SegmentView, config: AssociationConfig, min_length: float
) -> Pairs:
    """Pairs within angle, offset and extent, gated by chi-square with 2 degrees of freedom."""
    V, f = area.V, area.features
    walls = np.flatnonzero(f.kind == WALL)
    segments = np.flatnonzero(view.length >= min_length)
    if not len(walls) or not len(segments):
        return Pairs(_NONE, _NONE, np.zeros(0), np.zeros(0))
    R_s_l = se2.between(measuring_pose(V), V.poses[1 + walls])
    c, s = np.cos(R_s_l[:, 2]), np.sin(R_s_l[:, 2])
    dtheta = se2.wrap(view.theta[segments, None] - R_s_l[:, 2])
    ends = view.ends[segments].reshape(-1, 1, 2) - R_s_l[:, :2]
    x = (c * ends[..., 0] + s * ends[..., 1]).reshape(len(segments), 2, len(walls))
    y = (-s * ends[..., 0] + c * ends[..., 1]).reshape(len(segments), 2, len(walls))
    gap = np.maximum(f.lo[walls] - x.max(axis=1), x.min(axis=1) - f.hi[walls])
    ok = (
        (np.abs(dtheta) < config.max_angle)
        & (np.abs(y.mean(axis=1)) < config.max_offset)
        & (gap < config.max_gap)
    )
    i, j = np.nonzero(ok)
    if not len(i):
        return Pairs(_NONE, _NONE, np.zeros(0), np.zeros(0))
    distance, log_det = _pair_distances(V, view, segments[i], walls[j])
    gate = chi_square(config.gate, 2)
    good = distance < gate
    i, j, distance, log_det = i[good], j[good], distance[good], log_det[good]
    overlap = np.clip(-gap[i, j] / np.maximum(view.length[segments[i]], 1e-6), -1.0, 1.0)
    cost = distance + log_det - 2.0 * overlap
    order = np.lexsort((cost, i))
    return Pairs(segments[i[order]], walls[j[order]], cost[order], distance[order])


def _pair_distances(
    V: StochasticMap, view: SegmentView, segment: Index, wall: Index
) -> tuple[Array, Array]:
    """Squared Mahalanobis distance and log det S of each pair's (y, theta) innovation.

    The laser's x error is left out of S here: it only ranks and gates single pairs, and is in
    the joint test that decides.
    """
    matches = Matches(segment, wall, _NONE, _NONE, _NONE)
    rows = match_rows(V, view, matches)
    nu = rows.innovation.reshape(-1, 2)
    P = V.covariance
    columns = V.first_object + 3 * wall[:, None] + np.arange(3)
    P_ll = P[columns[:, :, None], columns[:, None, :]]
    P_lr = P[columns][:, :, :3]
    relative = P[:3, :3] + P_ll - P_lr - P_lr.transpose(0, 2, 1)
    H = rows.H_object.reshape(-1, 2, 3)
    if V.coordinates == "additive":
        T_l, T_r = se2.invariant_D_additive(V.poses[1 + wall]), se2.invariant_D_additive(V.robot)
        cross = T_l @ P_lr @ T_r.T
        relative = (
            T_r @ P[:3, :3] @ T_r.T
            + T_l @ P_ll @ T_l.transpose(0, 2, 1)
            - cross
            - cross.transpose(0, 2, 1)
        )
    S = H @ relative @ H.transpose(0, 2, 1) + _pair_noise(V, view, segment, wall)
    det = S[:, 0, 0] * S[:, 1, 1] - S[:, 0, 1] ** 2
    d2 = (
        S[:, 1, 1] * nu[:, 0] ** 2 - 2.0 * S[:, 0, 1] * nu[:, 0] * nu[:, 1] + S[:, 0, 0] * nu[:, 1] ** 2
    ) / det
    return d2, np.log(det)


def _pair_noise(V: StochasticMap, view: SegmentView, segment: Index, wall: Index) -> Array:
    """R of each pair alone, (c, 2, 2): the diagonal blocks of `match_noise`."""
    R_s_l = se2.between(measuring_pose(V), V.poses[1 + wall])
    d = view.centre[segment] - R_s_l[:, :2]
    x = np.cos(R_s_l[:, 2]) * d[:, 0] + np.sin(R_s_l[:, 2]) * d[:, 1]
    var_theta, var_y = view.var_theta[segment], view.var_y[segment]
    R = np.empty((len(segment), 2, 2))
    R[:, 0, 0] = var_y + x**2 * var_theta
    R[:, 0, 1] = R[:, 1, 0] = -x * var_theta
    R[:, 1, 1] = var_theta
    return R


def associate(
    area: AreaMap, view: SegmentView, config: AssociationConfig, filter_config: FilterConfig
) -> Association:
    """Segments to walls by joint compatibility, then their ends to the ends of those walls."""
    V = area.V
    pairs = wall_pairs(area, view, config, filter_config.min_match_length)
    near = np.zeros(len(view), dtype=bool)
    near[pairs.segment] = True
    offered = int(np.sum(view.length >= filter_config.min_match_length))
    chosen = _jointly_compatible(V, view, pairs, config)
    segment, wall = pairs.segment[chosen], pairs.wall[chosen]
    end_segment, end_side, end = _match_ends(area, view, segment, wall, config)
    return Association(Matches(segment, wall, end_segment, end_side, end), near, offered)


def _jointly_compatible(
    V: StochasticMap, view: SegmentView, pairs: Pairs, config: AssociationConfig
) -> Index:
    if not len(pairs.segment):
        return _NONE
    # The longest segments, the best few candidates of each.
    first = np.flatnonzero(np.r_[True, pairs.segment[1:] != pairs.segment[:-1]])
    rank = np.arange(len(pairs.segment)) - np.repeat(first, np.diff(np.r_[first, len(pairs.segment)]))
    longest = pairs.segment[first]
    if len(longest) > MAX_SEGMENTS:
        longest = longest[np.argsort(-view.length[longest], kind="stable")[:MAX_SEGMENTS]]
    tried = np.flatnonzero((rank < MAX_CANDIDATES) & np.isin(pairs.segment, longest))
    segment, wall = pairs.segment[tried], pairs.wall[tried]
    matches = Matches(segment, wall, _NONE, _NONE, _NONE)
    rows = match_rows(V, view, matches)
    columns, H = jacobian(V, rows)
    S = gain(V.covariance, columns, H, match_noise(V, view, matches)).S
    candidates = Candidates(segment, wall, pairs.cost[tried], rows.innovation.reshape(-1, 2), S)
    return tried[joint_compatibility(candidates, config.gate)]


def _match_ends(
    area: AreaMap, view: SegmentView, segment: Index, wall: Index, config: AssociationConfig
) -> tuple[Index, Index, Index]:
    """Ends of matched segments against the known ends of the same wall and side."""
    V, f = area.V, area.features
    ends = np.flatnonzero(f.kind == END)
    i, side = np.nonzero(view.end_kind[segment] != END_OPEN)
    if not len(ends) or not len(i):
        return _NONE, _NONE, _NONE
    a, b = np.nonzero(
        (f.wall[ends][None, :] == f.uid[wall[i]][:, None]) & (f.side[ends][None, :] == side[:, None])
    )
    if not len(a):
        return _NONE, _NONE, _NONE
    matches = Matches(_NONE, _NONE, segment[i[a]], side[a], ends[b])
    rows = match_rows(V, view, matches)
    columns, H = jacobian(V, rows)
    S = np.diag(gain(V.covariance, columns, H, match_noise(V, view, matches)).S)
    d2 = rows.innovation**2 / S
    order = np.lexsort((d2,))
    taken_a: set[int] = set()
    taken_b: set[int] = set()
    chosen = []
    for k in order:
        if d2[k] > chi_square(config.gate, 1):
            break
        if int(a[k]) in taken_a or int(b[k]) in taken_b:
            continue
        taken_a.add(int(a[k]))
        taken_b.add(int(b[k]))
        chosen.append(k)
    pick = np.sort(np.array(chosen, dtype=np.int64))
    return matches.end_segment[pick], matches.end_side[pick], matches.end[pick]
