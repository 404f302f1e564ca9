"""A step of an area's filter from increment and scan to the area after them, and what if it fails.

Nothing here has a consequence beyond the values that are returned: hypotheses are filtered by
the same functions as what is believed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.estimation import motion as odometry_model
from hiermap_cli.estimation.association import chi_square
from hiermap_cli.estimation.noise import NoiseScale
from hiermap_cli.estimation.stochastic_map import Motion, predict
from hiermap_cli.mapping.association.area_filter import Step, believed, observe
from hiermap_cli.mapping.association.matching import associate
from hiermap_cli.mapping.association.relocation import relocate, robot_found, widened
from hiermap_cli.perception.views import with_noise

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import Config
    from hiermap_cli.mapping.area_map import AreaMap
    from hiermap_cli.mapping.association.sighting import Matches
    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]


@dataclass(slots=True)
class Stepper:
    """Filters areas with the noise that this log has, as far as that is known by now."""

    config: Config
    noise: NoiseScale = field(default_factory=NoiseScale)
    _wide: Config = field(init=False)

    def __post_init__(self) -> None:
        c = self.config
        wide = c.association.model_copy(update={"max_angle": c.relocation.slip_max_angle})
        self._wide = c.model_copy(update={"association": wide})

    def noisy(self, view: SegmentView) -> SegmentView:
        """A scan's view with the noise of this log."""
        return with_noise(view, self.config.filter, self.noise.laser, self.noise.walls)

    def motion(self, area: AreaMap, increment: Array, *, trusted: bool = True) -> Motion:
        """The motion of an odometry increment, by what is known of the odometry so far."""
        motion = odometry_model.motion(increment, area.V.parameters, self.config.odometry)
        motion = motion._replace(covariance=self.noise.odometry * motion.covariance)
        return motion if trusted else odometry_model.distrusted(motion, self.config.odometry)

    def filtered(
        self, area: AreaMap, increment: Array, view: SegmentView, key: int
    ) -> tuple[Motion, Step]:
        """An area after an increment and a `noisy` view."""
        motion = self.motion(area, increment)
        return motion, observe(area.with_map(predict(area.V, motion)), view, key, self.config)

    def found_again(
        self, area: AreaMap, view: SegmentView, step: Step, key: int, *, suspect: bool
    ) -> Step | None:
        """The step taken from where the scan itself says the robot is, if that explains more.

        That is a pose found among the walls, or else the prediction with room for an error.
        """
        c = self.config.relocation
        found = relocate(area, view, c, suspect=suspect)
        tried = [robot_found(area.V, found.pose, c)] if found is not None else []
        tried.append(widened(area.V, c))
        total, so_far = float(view.length.sum()), matched_length(view, step.matches)
        wide = self._wide
        for hypothesis in tried:
            there = area.with_map(hypothesis)
            again = associate(there, view, wide.association, wide.filter)
            matched = matched_length(view, again.matches)
            more = matched - so_far >= max(c.gain * total, c.min_gain)
            if more and matched >= max(c.min_share * total, c.min_explained):
                return believed(there, view, again, key, wide)
        return None

    def is_poor(
        self, area: AreaMap, view: SegmentView, step: Step, known: int | None = None
    ) -> bool:
        """Whether so little of a scan matched that the prediction is in doubt.

        Of walls with a uid below `known`, if given: those begun since prove nothing.
        """
        if len(view.length) < 3 or len(area.features.uid) <= 3:
            return False
        length, segments = view.length.tolist(), step.matches.segment.tolist()
        if known is not None:
            uids = step.area.features.uid[step.matches.wall].tolist()
            segments = [i for i, uid in zip(segments, uids, strict=True) if uid < known]
        # A dozen numbers are added sooner than an array function is called.
        least = self.config.relocation.poor_match * sum(length)
        return bool(sum([length[i] for i in segments]) < least)

    def misfit(self, step: Step) -> float:
        """How badly a scan fits the walls: NIS, and the gate for each segment without a wall."""
        missed = step.offered - len(step.matches.wall)
        return step.nis + chi_square(self.config.association.gate, 2) * missed


def matched_walls(view: SegmentView, step: Step) -> Index:
    """The uid of the wall that each segment was matched with, -1 for none, (s,)."""
    walls = np.full(len(view.length), -1)
    walls[step.matches.segment] = step.area.features.uid[step.matches.wall]
    return walls


def matched_length(view: SegmentView, matches: Matches) -> float:
    """Metres of the scan's segments that were matched."""
    return float(view.length[matches.segment].sum())
