"""What the filter takes from one scan: its segments as lines with noise, and their ends."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from hiermap_cli.perception.segments import END_OPEN

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from hiermap_cli.config import FilterConfig
    from hiermap_cli.perception.segments import SegmentBlock

    Array = NDArray[np.float64]


class SegmentView(NamedTuple):
    """The s segments of one scan, in the robot's frame at the scan.

    centre: (s, 2). theta: (s,) heading from p1 to p2, the free side on the left.
    var_theta, var_y: (s,) variances of the heading and of the offset across the line at the
    centre. ends: (s, 2, 2) p1 and p2. end_kind: (s, 2). end_sigma: (s, 2) along the line.
    length: (s,).
    """

    centre: Array
    theta: Array
    var_theta: Array
    var_y: Array
    ends: Array
    end_kind: NDArray[np.int64]
    end_sigma: Array
    length: Array


def scan_views(segments: SegmentBlock, scans: int) -> Iterator[SegmentView]:
    """One view a scan of the block, with the sensor's noise alone."""
    bounds = np.searchsorted(segments.scan, np.arange(scans + 1)).tolist()
    theta = segments.alpha + 0.5 * np.pi
    ends = np.stack((segments.p1, segments.p2), axis=1)
    kind = np.stack((segments.end1, segments.end2), axis=1)
    for i in range(scans):
        s = slice(bounds[i], bounds[i + 1])
        yield SegmentView(
            segments.centre[s],
            theta[s],
            segments.covariance[s, 0, 0],
            segments.covariance[s, 1, 1],
            ends[s],
            kind[s],
            segments.end_sigma[s],
            segments.length[s],
        )


def measured(view: SegmentView, features: Literal["all", "walls", "landmarks"]) -> SegmentView:
    """What of a view may be measured.

    walls: segments, none of which is known to end. landmarks: segments that show an end or a
    corner, so that each tells a whole pose.
    """
    if features == "all":
        return view
    if features == "walls":
        return view._replace(end_kind=np.full_like(view.end_kind, END_OPEN))
    shown = (view.end_kind != END_OPEN).any(axis=1)
    return SegmentView._make(column[shown] for column in view)


def with_noise(view: SegmentView, config: FilterConfig, laser: float, walls: float) -> SegmentView:
    """The view with the noise of this log.

    laser: factor on the variances of the line fits. walls: factor on the variance of the walls'
    unevenness, which is added to them.

    A line that is only `length` long says less of its wall's direction than of its own: an
    unevenness of `wall_sigma` over the length adds to the heading's.
    """
    var = walls * config.wall_sigma**2
    var_theta = laser * view.var_theta + walls * config.wall_sigma_theta**2
    return view._replace(
        var_theta=var_theta + var / np.square(np.maximum(view.length, 0.1)),
        var_y=laser * view.var_y + var,
        end_sigma=np.sqrt(np.square(view.end_sigma) + walls * config.end_sigma**2),
    )
