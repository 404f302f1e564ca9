"""A narrow place asked for once more, without the people who stood about it.

While the robot goes, an end of a beam counts for a jamb unless the scans right before or after it
have looked through the place. Who stands in a doorway until the robot comes, or gives way beside
it, is there for longer; then the chord lies between one jamb and a person, and the line through
both is no wall. With the robot past the place, all scans of the last metres are asked.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.mapping.topology.chords import WIDEST, narrowest_chord
from hiermap_cli.mapping.topology.door_evidence import is_door
from hiermap_cli.mapping.topology.passages import BESIDE, NEAR, SAMPLE, passage_between
from hiermap_cli.mapping.topology.passers import gone_over, looked, seen_through

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import DoorConfig
    from hiermap_cli.mapping.topology.passages import Passage, PassageDetector, Trace

    Array = NDArray[np.float64]

STAYED = 0.15  # metres from a jamb within which something was there all the time
LATELY = 2.5  # metres of path on which a door may have been missed


def door_of(
    passage: Passage, detector: PassageDetector, trace: Trace, config: DoorConfig
) -> Passage | None:
    """A narrow place that is a door, or the door there if what made it narrower did not stay."""
    if is_door(passage, config):
        return passage
    jambs = detector.jambs[bisect_left(detector.at, passage.travelled)]
    s = passage.travelled
    return _best_door(trace, s - config.reach, s + config.reach, config, jambs)


def door_missed(trace: Trace, config: DoorConfig) -> Passage | None:
    """The door that lies on the last metres of the path and that people have hidden, if any."""
    return _best_door(trace, trace.length - LATELY, trace.length, config)


def _best_door(
    trace: Trace, first: float, last: float, config: DoorConfig, jambs: Array | None = None
) -> Passage | None:
    """The door with the most wall beside it that was passed between so many metres of path.

    Those passed before the robot came into the present area are known. None is told if both
    `jambs` (2, 2) were there all the time.
    """
    reach, first = config.reach, max(first, trace.entered)
    low, high = max(first - reach, trace.travelled[0]), min(last + reach, trace.length)
    at = np.arange(low, high, SAMPLE).tolist()
    points = [trace.at(s) for s in at]
    if not points or len(trace.poses) < 2:
        return None
    ends = _lasting(trace, bisect_left(trace.travelled, low - NEAR), [p for p, _ in points])
    if jambs is not None and all(_is_near(ends, jamb) for jamb in jambs):
        return None
    chords = [narrowest_chord(p, ends, config.max_width + config.widening) for p, _ in points]
    width = [chord for chord, _ in chords]
    doors = []
    for i in range(bisect_left(at, first), bisect_right(at, last)):
        near = width[bisect_left(at, at[i] - BESIDE) : bisect_right(at, at[i] + BESIDE)]
        before = width[bisect_left(at, at[i] - reach) : i]
        after = width[i + 1 : bisect_right(at, at[i] + reach)]
        wider = min(max(before, default=0.0), max(after, default=0.0)) - config.widening
        if config.min_width <= width[i] <= config.max_width and width[i] <= min(wider, *near):
            found = passage_between(chords[i][1], points[i][1], width[i], at[i], trace)
            if found is not None and is_door(found, config):
                doors.append(found)
    return max(doors, key=lambda one: one.evidence, default=None)


def _is_near(ends: Array, point: Array) -> bool:
    d = ends - point
    return bool(((d * d).sum(axis=1) < STAYED * STAYED).any())


def _lasting(trace: Trace, since: int, path: list[Array]) -> Array:
    """Ends (n, 2) near this path, of the scans since one, that were there for all of them."""
    ends = trace.near.since(since)
    middle = np.array(path)
    low, high = middle.min(axis=0) - WIDEST, middle.max(axis=0) + WIDEST
    ends = ends[((ends > low) & (ends < high)).all(axis=1)]
    gone = gone_over(ends, trace.poses[since:])
    for k in range(max(since, 0), len(trace.poses)):
        if len(trace.near.of(k)):
            look = looked(trace.origins[k], trace.ends[k], ends[:0])
            gone |= seen_through(look, ends)
    return np.asarray(ends[~gone])
