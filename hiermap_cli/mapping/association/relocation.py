"""Where is the robot in an area whose prediction cannot be trusted?

Two segments of the scan that are not parallel, taken for two walls of the area, give a whole
pose of the robot. All such hypotheses near enough to the prediction are scored at once by how
much of the scan's segments they lay on walls; the best one is taken when it explains most of the
scan and is well ahead of every different one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.geometry.median import median
from hiermap_cli.mapping.area_map import WALL

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import RelocationConfig
    from hiermap_cli.estimation.stochastic_map import StochasticMap
    from hiermap_cli.mapping.area_map import AreaMap
    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

MAX_SEGMENTS, MAX_HYPOTHESES = 8, 4000


class Lines(NamedTuple):
    """Walls of an area.

    Heading (w,), unit normals to the free side (w, 2), offset (w,) along it, and extents lo, hi
    (w,) along the heading from the foot of the origin.
    """

    theta: Array
    normal: Array
    offset: Array
    lo: Array
    hi: Array


class Hypothesis(NamedTuple):
    """A pose (3,) of the robot in the area, and how much of the scan it explains.

    explained: metres of segment that it lays on walls, of `total` that there are. second: the
    metres of the best hypothesis that is elsewhere.
    """

    pose: Array
    explained: float
    total: float
    second: float


def area_lines(area: AreaMap, least_seen: int) -> Lines:
    """The walls of the area that were seen at least so often, as lines."""
    f = area.features
    walls = np.flatnonzero((f.kind == WALL) & (f.seen >= least_seen))
    X = area.V.poses[1 + walls]
    direction = np.column_stack((np.cos(X[:, 2]), np.sin(X[:, 2])))
    normal = np.column_stack((-direction[:, 1], direction[:, 0]))
    along = (X[:, :2] * direction).sum(axis=1)
    return Lines(
        X[:, 2], normal, (X[:, :2] * normal).sum(axis=1), along + f.lo[walls], along + f.hi[walls]
    )


def search_window(
    V: StochasticMap, config: RelocationConfig, *, suspect: bool
) -> tuple[float, float]:
    """Metres and radians about the prediction to search.

    All that is searched where odometry is suspect, else what the prediction's covariance leaves
    open.
    """
    if suspect:
        return config.max_distance, config.max_turn
    C = V.pose_covariance(0)
    distance = config.window_sigmas * float(np.sqrt(max(C[0, 0] + C[1, 1], 0.0)))
    turn = config.window_sigmas * float(np.sqrt(max(C[2, 2], 0.0)))
    return (
        min(max(distance, config.min_distance), config.max_distance),
        min(max(turn, config.min_turn), config.max_turn),
    )


def relocate(
    area: AreaMap, view: SegmentView, config: RelocationConfig, *, suspect: bool
) -> Hypothesis | None:
    """The pose that explains the scan, in the `search_window`, if one explains it clearly.

    None where none does.
    """
    max_distance, max_angle = search_window(area.V, config, suspect=suspect)
    lines = area_lines(area, config.least_seen)
    longest = np.argsort(-view.length, kind="stable")[:MAX_SEGMENTS]
    longest = longest[view.length[longest] >= config.min_length]
    if len(longest) < 2 or len(lines.theta) < 2:
        return None
    poses = _hypotheses(lines, view, longest, area.V.robot, max_distance, max_angle)
    if not len(poses):
        return None
    score = explained_length(lines, view, poses, config)
    best = int(np.argmax(score))
    apart = np.hypot(*(poses[:, :2] - poses[best, :2]).T) > config.distinct
    apart |= np.abs(se2.wrap(poses[:, 2] - poses[best, 2])) > config.distinct_angle
    second = float(score[apart].max()) if apart.any() else 0.0
    total = float(view.length.sum())
    # Of those as good as the best, the middle: single pairs of short lines are inexact.
    same = ~apart & (score >= 0.9 * score[best])
    pose = poses[best].copy()
    pose[:2] = median(poses[same, :2])
    pose[2] += median(se2.wrap(poses[same, 2] - poses[best, 2]))
    found = Hypothesis(pose, float(score[best]), total, second)
    clear = (
        found.explained >= config.min_share * total and second <= config.second * found.explained
    )
    return found if clear and found.explained >= config.min_explained else None


def robot_found(V: StochasticMap, pose: Array, config: RelocationConfig) -> StochasticMap:
    """V with the robot at a pose found by the scan alone.

    What is known of it is that it is somewhere about there, and nothing that its way there had in
    common with the map.
    """
    P = V.covariance.copy()
    P[:3], P[:, :3] = 0.0, 0.0
    spread = np.diag(np.square([config.sigma, config.sigma, config.sigma_angle]))
    Ad = V.error_D_tangent(pose)
    P[:3, :3] = Ad @ spread @ Ad.T
    poses = V.poses.copy()
    poses[0] = pose
    return V._replace(poses=poses, covariance=P)


def widened(V: StochasticMap, config: RelocationConfig) -> StochasticMap:
    """V with room for an error of the odometry's last step that its noise does not explain.

    A slip along a corridor, where walls are all parallel and give no whole pose.
    """
    spread = np.diag(np.square([config.slip, config.slip, config.slip_angle]))
    Ad = V.error_D_tangent(V.robot)
    P = V.covariance.copy()
    P[:3, :3] += Ad @ spread @ Ad.T
    return V._replace(covariance=P)


def _hypotheses(
    lines: Lines, view: SegmentView, segments: Index, near: Array, distance: float, angle: float
) -> Array:
    """Poses (h, 3) from all pairs of segments on all pairs of walls, near the prediction."""
    # One segment on one wall fixes the heading ...
    turn = se2.wrap(lines.theta[None] - view.theta[segments, None] - near[2])
    s, w = np.nonzero(np.abs(turn) <= angle)
    theta = near[2] + turn[s, w]
    # ... and its distance from that wall; two of them with one heading give the position.
    normal = lines.normal[w]
    c, si = np.cos(theta), np.sin(theta)
    centre = view.centre[segments[s]]
    centre_a = np.column_stack(
        (c * centre[:, 0] - si * centre[:, 1], si * centre[:, 0] + c * centre[:, 1])
    )
    offset = lines.offset[w] - (normal * centre_a).sum(axis=1)
    i, j = np.triu_indices(len(s), 1)
    ok = (s[i] != s[j]) & (np.abs(se2.wrap(theta[i] - theta[j])) < 0.1)
    cross = normal[i, 0] * normal[j, 1] - normal[i, 1] * normal[j, 0]
    ok &= np.abs(cross) > 0.4
    i, j, cross = i[ok], j[ok], cross[ok]
    x = (offset[i] * normal[j, 1] - offset[j] * normal[i, 1]) / cross
    y = (normal[i, 0] * offset[j] - normal[j, 0] * offset[i]) / cross
    heading = theta[i] + 0.5 * se2.wrap(theta[j] - theta[i])
    poses = np.column_stack((x, y, se2.wrap(heading)))
    poses = poses[np.hypot(x - near[0], y - near[1]) <= distance]
    if len(poses) > MAX_HYPOTHESES:
        rank = np.argsort(np.hypot(*(poses[:, :2] - near[:2]).T), kind="stable")
        poses = poses[np.sort(rank[:MAX_HYPOTHESES])]
    return np.asarray(poses)


def explained_length(
    lines: Lines, view: SegmentView, poses: Array, config: RelocationConfig
) -> Array:
    """Metres of the scan's segments that lie on walls, for each pose (h,)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    ends = view.ends.reshape(-1, 2)
    x = poses[:, :1] + c[:, None] * ends[:, 0] - s[:, None] * ends[:, 1]
    y = poses[:, 1:2] + s[:, None] * ends[:, 0] + c[:, None] * ends[:, 1]
    h, n = len(poses), len(view.length)
    x, y = x.reshape(h, n, 2, 1), y.reshape(h, n, 2, 1)
    angle = np.abs(se2.wrap(view.theta[:, None] + poses[:, 2, None, None] - lines.theta))
    across = x * lines.normal[:, 0] + y * lines.normal[:, 1] - lines.offset
    along = x * lines.normal[:, 1] - y * lines.normal[:, 0]
    fits = (angle < config.max_angle) & (np.abs(across).max(axis=2) < config.max_offset)
    overlap = np.minimum(along.max(axis=2), lines.hi) - np.maximum(along.min(axis=2), lines.lo)
    overlap = np.where(fits, np.clip(overlap, 0.0, view.length[:, None]), 0.0)
    return np.asarray(overlap.max(axis=2).sum(axis=1))
