"""What the filter takes from the scans of a block, worked out for those that it asks for.

Of the scans between key scans the filter alone needs nothing but their odometry. Which will be
key scans is foretold by the odometry as it is told; where that was wrong, it is foretold anew.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.estimation.noise import residual_factor
from hiermap_cli.perception.segmentation import segment_block
from hiermap_cli.perception.sight import sights
from hiermap_cli.perception.views import measured, scan_views

if TYPE_CHECKING:
    from hiermap_cli.config import Config
    from hiermap_cli.logs.records import ScanBlock
    from hiermap_cli.perception.segments import SegmentBlock
    from hiermap_cli.perception.sight import Sight
    from hiermap_cli.perception.views import SegmentView

PART = 256  # scans after which is asked whether the noise is known

_TURN = 2.0 * math.pi


class SeenBlock:
    """The views and sights of a block's scans, by their place in it."""

    def __init__(self, block: ScanBlock, config: Config) -> None:
        self.block = block
        self._config = config
        self._views: dict[int, SegmentView] = {}
        self._sights: dict[int, Sight] = {}

    def view(self, place: int) -> SegmentView:
        """The segments of a scan."""
        if place not in self._views:
            self._look(self._key_scans(place))
        return self._views[place]

    def sight(self, place: int) -> Sight:
        """The space about the robot that a scan tells of."""
        if place not in self._views:
            self._look(self._key_scans(place))
        return self._sights[place]

    def laser_factor(self) -> float:
        """The laser's variance over the configured one, by the residuals of all line fits."""
        segments = self._look(list(range(len(self.block))))
        return residual_factor(segments.chi2, segments.points - 2, self._config.noise)

    def _key_scans(self, first: int) -> list[int]:
        """The scans from `first` on that will be asked for, as far as can be foretold."""
        if self._config.refine.enabled:
            return list(range(len(self.block)))
        filter_ = self._config.filter
        odometry = self.block.odometry.tolist()
        places, (x0, y0, theta0) = [first], odometry[first]
        for place in range(first + 1, len(odometry)):
            x, y, theta = odometry[place]
            if (
                math.hypot(x - x0, y - y0) >= filter_.key_distance
                or abs(math.remainder(theta - theta0, _TURN)) >= filter_.key_angle
            ):
                places.append(place)
                x0, y0, theta0 = x, y, theta
        return [place for place in places if place not in self._views]

    def _look(self, places: list[int]) -> SegmentBlock:
        """Segment the scans at `places` together, and keep what is asked of them."""
        block, config = self.block, self._config
        if len(places) < len(block):
            block = block.part(np.array(places))
        segments = segment_block(block, config.laser, config.segmentation)
        features = config.filter.features
        views = (measured(view, features) for view in scan_views(segments, len(block)))
        self._views.update(zip(places, views, strict=True))
        self._sights.update(zip(places, sights(block, config.laser), strict=True))
        return segments


def parted(block: ScanBlock, config: Config, size: int = PART) -> list[SeenBlock]:
    """A block in parts of at most `size` scans."""
    parts = (block.part(slice(start, start + size)) for start in range(0, len(block), size))
    return [SeenBlock(part, config) for part in parts]
