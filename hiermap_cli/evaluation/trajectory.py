"""Error of a trajectory against another: absolute (ATE) and relative (RPE) pose error.

Both put the estimate at the reference's stamps first. On equal stamps they agree with
`evo_ape tum -a` and `evo_rpe tum -d 1 -u m`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry.se2 import between, compose, interpolate, wrap
from hiermap_cli.mapping.model import Metric

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Stamps = NDArray[np.int64]

MAX_GAP_S = 0.5  # a reference stamp farther than this from an estimated pose is not compared


class PosesAt(NamedTuple):
    """Poses (Q, 3) at asked stamps, and (Q,) whether a pose lies near enough in time."""

    poses: Array
    found: NDArray[np.bool_]


def poses_at(stamps_ns: Stamps, poses: Array, at_ns: Stamps, max_gap_s: float) -> PosesAt:
    """A trajectory at other stamps: linear between its poses, shortest arc in the heading.

    Args:
        stamps_ns: (N,) stamps of the trajectory, in any order; of equal ones the last counts.
        poses: (N, 3).
        at_ns: (Q,) stamps to interpolate at; beyond the ends the nearest pose is taken.
        max_gap_s: seconds; a stamp whose nearest pose is farther is not found.
    """
    at_ns = np.asarray(at_ns, dtype=np.int64)
    if len(stamps_ns) == 0:
        return PosesAt(np.zeros((len(at_ns), 3)), np.zeros(len(at_ns), dtype=bool))
    order = np.argsort(stamps_ns, kind="stable")
    stamps_ns, poses = np.asarray(stamps_ns)[order], np.asarray(poses, dtype=float)[order]
    before = np.clip(np.searchsorted(stamps_ns, at_ns, side="right") - 1, 0, len(stamps_ns) - 1)
    after = np.minimum(before + 1, len(stamps_ns) - 1)
    span = (stamps_ns[after] - stamps_ns[before]).astype(float)
    since = (at_ns - stamps_ns[before]).astype(float)
    fraction = np.clip(np.divide(since, span, out=np.zeros_like(span), where=span > 0), 0.0, 1.0)
    gap = np.minimum(np.abs(since), np.abs((stamps_ns[after] - at_ns).astype(float)))
    return PosesAt(interpolate(poses[before], poses[after], fraction), gap <= max_gap_s * 1e9)


def align_se2(points_a: Array, points_b: Array) -> Array:
    """`R_b_a` (3,) that brings points of frame a, (N, 2), nearest to those of b (Umeyama 1991).

    Least squares over rotation and translation; with no spread the rotation is zero.
    """
    mean_a, mean_b = points_a.mean(axis=0), points_b.mean(axis=0)
    a, b = points_a - mean_a, points_b - mean_b
    dot = float((a * b).sum())
    cross = float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    theta = math.atan2(cross, dot)
    c, s = math.cos(theta), math.sin(theta)
    shift = mean_b - np.array([c * mean_a[0] - s * mean_a[1], s * mean_a[0] + c * mean_a[1]])
    return np.array([shift[0], shift[1], theta])


class AteMetrics(NamedTuple):
    """Translation error in metres after the best alignment `R_t_g`; nan where `n` is 0."""

    rmse: float
    mean: float
    max: float
    n: int
    alignment: Array  # (3,): the estimate's frame g seen from the reference's frame t

    def metrics(self) -> tuple[Metric, ...]:
        """The figures under the names of eval.json; none where nothing was measured."""
        if self.n == 0:
            return ()
        return (
            Metric("ate_rmse", "m", self.rmse, self.n),
            Metric("ate_mean", "m", self.mean, self.n),
            Metric("ate_max", "m", self.max, self.n),
        )


def ate(
    stamps_ns: Stamps,
    poses: Array,
    reference_ns: Stamps,
    reference: Array,
    *,
    max_gap_s: float = MAX_GAP_S,
) -> AteMetrics:
    """Absolute trajectory error of `poses` (N, 3) against `reference` (T, 3).

    The estimate is interpolated at the reference's stamps; one with no estimated pose within
    `max_gap_s` is left out. Fewer than two common stamps measure nothing.
    """
    estimate, found = poses_at(stamps_ns, poses, reference_ns, max_gap_s)
    n = int(found.sum())
    if n < 2:
        return AteMetrics(math.nan, math.nan, math.nan, 0, np.full(3, math.nan))
    R_t_g = align_se2(estimate[found, :2], reference[found, :2])
    aligned = compose(R_t_g, estimate[found])
    errors = np.hypot(*(aligned[:, :2] - reference[found, :2]).T)
    return AteMetrics(
        float(np.sqrt(np.mean(errors**2))), float(errors.mean()), float(errors.max()), n, R_t_g
    )


class RpeMetrics(NamedTuple):
    """Root mean square error of relative poses: metres and radians; nan where `n` is 0."""

    trans_rmse: float
    rot_rmse: float
    n: int

    def metrics(self) -> tuple[Metric, ...]:
        """The figures under the names of eval.json; none where nothing was measured."""
        if self.n == 0:
            return ()
        return (
            Metric("rpe_trans_rmse", "m", self.trans_rmse, self.n),
            Metric("rpe_rot_rmse", "rad", self.rot_rmse, self.n),
        )


def rpe(
    stamps_ns: Stamps,
    poses: Array,
    reference_ns: Stamps,
    reference: Array,
    *,
    distance: float = 1.0,
    max_gap_s: float = MAX_GAP_S,
) -> RpeMetrics:
    """Relative pose error over successive stretches of `distance` metres of the estimate's path.

    A stretch ends at the first pose whose path since its start is at least `distance`, and the
    next begins there, as evo cuts them; errors are not divided by the distance.
    """
    at, found = poses_at(stamps_ns, poses, reference_ns, max_gap_s)
    estimate, reference = at[found], np.asarray(reference, dtype=float)[found]
    ends = _stretches(estimate[:, :2], distance)
    if len(ends) < 2:
        return RpeMetrics(math.nan, math.nan, 0)
    error = between(
        between(reference[ends[:-1]], reference[ends[1:]]),
        between(estimate[ends[:-1]], estimate[ends[1:]]),
    )
    return RpeMetrics(
        float(np.sqrt(np.mean((error[:, :2] ** 2).sum(axis=1)))),
        float(np.sqrt(np.mean(wrap(error[:, 2]) ** 2))),
        len(error),
    )


def _stretches(points: Array, distance: float) -> NDArray[np.int64]:
    """Indices where a path over (N, 2) points is cut into stretches of at least `distance`."""
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64)
    ends, travelled = [0], 0.0
    for i, step in enumerate(np.hypot(*np.diff(points, axis=0).T).tolist(), start=1):
        travelled += step
        if travelled >= distance:
            ends.append(i)
            travelled = 0.0
    return np.array(ends, dtype=np.int64)
