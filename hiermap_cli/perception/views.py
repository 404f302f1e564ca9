"""What the filter takes from one scan: its segments as lines with noise, and their ends."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

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

    def __len__(self) -> int:  # type: ignore[override]
        """The number of segments (not of fields)."""
        return self.centre.shape[0]


def scan_views(segments: SegmentBlock, scans: int, config: FilterConfig) -> Iterator[SegmentView]:
    """One view a scan of the block, with the unevenness of walls added to the noise.

    A line that is only `length` long says less of its wall's direction than of its own: an
    unevenness of `wall_sigma` over half the length adds to the heading's.
    """
    bounds = np.searchsorted(segments.scan, np.arange(scans + 1))
    theta = segments.alpha + 0.5 * np.pi
    var_theta = segments.covariance[:, 0, 0] + config.wall_sigma_theta**2
    var_theta = var_theta + np.square(config.wall_sigma / np.maximum(segments.length, 0.1))
    var_y = segments.covariance[:, 1, 1] + config.wall_sigma**2
    ends = np.stack((segments.p1, segments.p2), axis=1)
    kind = np.stack((segments.end1, segments.end2), axis=1)
    sigma = np.hypot(segments.end_sigma, config.end_sigma)
    for i in range(scans):
        s = slice(bounds[i], bounds[i + 1])
        yield SegmentView(
            segments.centre[s],
            theta[s],
            var_theta[s],
            var_y[s],
            ends[s],
            kind[s],
            sigma[s],
            segments.length[s],
        )


def has_ends(view: SegmentView) -> bool:
    """Whether any segment of the view has an end that is not open."""
    return bool(np.any(view.end_kind != END_OPEN))
