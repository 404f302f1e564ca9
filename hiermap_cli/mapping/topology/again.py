"""A narrow place asked for once more, without the people who stood about it.

While the robot goes, an end of a beam counts for a jamb unless the scans right before or after it
have looked through the place. Who stands in a doorway until the robot comes, or gives way beside
it, is there for longer; then the chord lies between one jamb and a person, and the line through
both is no wall. With the robot past the place, all scans of the last metres are asked.

Where people go along with the robot the path is narrow before and behind a door as well, and no
narrow place is told at all. So the path is asked for once more a metre later, where somebody has
been about. As this is a second chance, more wall is wanted beside such a door.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.mapping.topology.chords import WIDEST, narrowest_chord
from hiermap_cli.mapping.topology.door_evidence import is_door, needed
from hiermap_cli.mapping.topology.passages import BESIDE, BIN, SAMPLE, passage_between
from hiermap_cli.mapping.topology.passers import gone_over, seen_through, surface
from hiermap_cli.mapping.topology.trace import NEAR

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import DoorConfig
    from hiermap_cli.mapping.topology.passage import Passage
    from hiermap_cli.mapping.topology.passages import PassageDetector
    from hiermap_cli.mapping.topology.trace import Trace

    Array = NDArray[np.float64]
    Mask = NDArray[np.bool_]

STAYED = 0.15  # metres from a jamb within which something was there all the time
LATELY = 2.5  # metres of path on which a door may have been missed
LATER = 1.0  # metres of path after which it is told which of what made it narrow has stayed
AT_ONCE = 0.8  # metres of path that are asked for together
SOMEBODY = 1.0  # metres of what stood about the robot that came and went, if people were there
BODY = 0.25  # metres: that much of somebody is seen about a point of him
AT_LEAST = 2  # scans that have looked through a place where somebody stood


def door_of(
    passage: Passage, detector: PassageDetector, trace: Trace, config: DoorConfig
) -> Passage | None:
    """A narrow place that is a door, or the door there if what made it narrow did not stay."""
    jambs = detector.jambs[bisect_left(detector.at, passage.travelled)]
    first, last = passage.travelled - config.reach, passage.travelled + config.reach
    door = passage if is_door(passage, config) else None
    if door is not None and not _somebody(trace, bisect_left(trace.travelled, first - NEAR)):
        return door
    around = _lasting_about(trace, first, last, config)
    if all(_near(around.ends, jamb, STAYED).any() for jamb in jambs):
        return door
    return _best_door(trace, around, first, last, config)


def door_missed(trace: Trace, config: DoorConfig) -> Passage | None:
    """The door that lies on the last metres of the path and that people have hidden, if any."""
    first, last = trace.length - LATELY, trace.length
    return _best_door(trace, _lasting_about(trace, first, last, config), first, last, config)


def door_hidden(detector: PassageDetector, trace: Trace, config: DoorConfig) -> Passage | None:
    """The door on a piece of the path a metre ago, where who made the path narrow did not stay.

    Each piece of the path is asked for once, some time later, and has to have all the wall that is
    `needed` beside it.
    """
    last = trace.length - LATER
    first = max(detector.asked, trace.entered - config.reach)
    if last - first < AT_ONCE:
        return None
    detector.asked = last
    at, width = detector.at, detector.width
    here = width[bisect_left(at, first) : bisect_left(at, last)]
    if min(here, default=np.inf) > config.max_width:
        return None
    around = range(bisect_left(at, first - config.reach), bisect_left(at, last + config.reach))
    narrow = config.max_width + config.widening
    jambs = np.concatenate([detector.jambs[i] for i in around if width[i] <= narrow])
    since = bisect_left(trace.travelled, first - NEAR)
    if not _somebody(trace, since) or not _has_left(trace, since, np.unique(jambs, axis=0)):
        return None
    door = _best_door(trace, _lasting_about(trace, first, last, config), first, last, config)
    sure = door is not None and door.evidence > needed(door.width) + 0.5 * BIN
    return door if sure else None


class _Around(NamedTuple):
    """A piece of the path: metres, points (2,) and ways (2,) of it; ends (n, 2) that lasted."""

    at: list[float]
    points: list[tuple[Array, Array]]
    ends: Array


def _lasting_about(trace: Trace, first: float, last: float, config: DoorConfig) -> _Around:
    """The path between so many metres of it, and a door's reach on either side."""
    low = max(first - config.reach, trace.travelled[0])
    at = np.arange(low, min(last + config.reach, trace.length), SAMPLE).tolist()
    if not at or len(trace.poses) < 2:
        return _Around([], [], np.zeros((0, 2)))
    points = [trace.at(s) for s in at]
    ends = _lasting(trace, bisect_left(trace.travelled, low - NEAR), [p for p, _ in points])
    return _Around(at, points, ends)


def _best_door(
    trace: Trace, around: _Around, first: float, last: float, config: DoorConfig
) -> Passage | None:
    """The door with the most wall beside it that was passed between so many metres of path.

    Those passed before the robot came into the present area are known.
    """
    at, points, ends = around
    reach, first = config.reach, max(first, trace.entered)

    @cache
    def chord(i: int) -> tuple[float, Array]:
        return narrowest_chord(points[i][0], ends, config.max_width + config.widening)

    def widest(since: int, until: int) -> float:
        return max((chord(i)[0] for i in range(since, until)), default=0.0)

    doors = []
    for i in range(bisect_left(at, first), bisect_right(at, last)):
        width, jambs = chord(i)
        if not config.min_width <= width <= config.max_width:
            continue
        near = range(bisect_left(at, at[i] - BESIDE), bisect_right(at, at[i] + BESIDE))
        before = widest(bisect_left(at, at[i] - reach), i)
        after = widest(i + 1, bisect_right(at, at[i] + reach))
        narrowest = width <= min(chord(k)[0] for k in near)
        if narrowest and width <= min(before, after) - config.widening:
            found = passage_between(jambs, points[i][1], width, at[i], trace)
            if found is not None and is_door(found, config):
                doors.append(found)
    return max(doors, key=lambda one: one.evidence, default=None)


def _near(ends: Array, point: Array, radius: float) -> Mask:
    d = ends - point
    return np.asarray((d * d).sum(axis=1) < radius * radius)


def _lasting(trace: Trace, since: int, path: list[Array]) -> Array:
    """Ends (n, 2) near this path, of the scans since one, that were there for all of them."""
    ends = trace.near.since(since)
    middle = np.array(path)
    low, high = middle.min(axis=0) - WIDEST, middle.max(axis=0) + WIDEST
    ends = ends[((ends > low) & (ends < high)).all(axis=1)]
    return np.asarray(ends[~_did_not_stay(trace, since, ends)])


def _did_not_stay(trace: Trace, since: int, points: Array) -> Mask:
    """Which of the points (n, 2) the scans since one looked through, or the robot went over."""
    gone = gone_over(points, trace.way.since(since))
    for looks in trace.looks[since:]:
        for look in looks:
            gone |= seen_through(look, points)
    return gone


def _somebody(trace: Trace, since: int) -> bool:
    """Whether so much of what was seen since a scan is gone, or new, that somebody was there."""
    return sum(one.gone for looks in trace.looks[since:] for one in looks) >= SOMEBODY


def _has_left(trace: Trace, since: int, points: Array) -> bool:
    """Whether at one of the points (n, 2) somebody stood, by the scans since one.

    Two have looked through the place, and none between those in which something was there: what is
    thin is hit by one scan, missed by the next, and hit again. And as much has gone as there is of
    somebody.
    """
    looks = [(k, one) for k in range(since, len(trace.poses)) for one in trace.looks[k]]
    through = np.array([seen_through(one, points) for _, one in looks]).reshape(-1, len(points))
    asked = np.flatnonzero(np.count_nonzero(through, axis=0) >= AT_LEAST)
    there = ended_about([trace.ends[k] for k, _ in looks], points[asked])
    for i, hits in zip(asked.tolist(), there.T, strict=True):
        hit = np.flatnonzero(hits)
        if not len(hit) or through[hit[0] : hit[-1] + 1, i].any():
            continue
        for j in hit.tolist():
            k, one = looks[j]
            about = trace.ends[k][_near(trace.ends[k], points[i], BODY)]
            gone = np.zeros(len(about), dtype=bool)
            for m in np.flatnonzero(through[:, i]).tolist():
                gone |= seen_through(looks[m][1], about)
            if surface(one, about[gone]) >= BODY:
                return True
    return False


def ended_about(ends: list[Array], points: Array) -> Mask:
    """(L, p) which of L scans, with their ends (n, 2), have ended within STAYED of which points."""
    if not len(points) or not ends:
        return np.zeros((len(ends), len(points)), dtype=bool)
    counts = [len(one) for one in ends]
    every = np.concatenate(ends)
    x, y = every[:, :1] - points[:, 0], every[:, 1:] - points[:, 1]
    about = np.concatenate((x * x + y * y < STAYED * STAYED, np.zeros((1, len(points)), bool)))
    starts = np.cumsum([0, *counts[:-1]])
    # Of a scan without ends `reduceat` gives the next one's first.
    return np.logical_or.reduceat(about, starts) & (np.array(counts) > 0)[:, None]
