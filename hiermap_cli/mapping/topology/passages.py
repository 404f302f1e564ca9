"""Narrow places on the robot's path, and what was seen of the line across them.

At every point of the path the free width is that of the narrowest chord through it, between two
places where beams ended, whatever its direction: so a door that is passed at a slant is as
narrow as one passed straight. Where the path is narrower than a little before and a little
after, the chord lies between two jambs, or between pieces of furniture. What tells them apart is
the line through both: from a door's jambs walls run on along it, where beams end and none
passes; beside furniture the beams go on.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.topology.chords import chord_frame, narrowest_chord
from hiermap_cli.mapping.topology.door_evidence import WIDER, is_door, longest_reach, reach_of
from hiermap_cli.mapping.topology.passage import Passage
from hiermap_cli.mapping.topology.passers import gone_over, went_over
from hiermap_cli.mapping.topology.trace import KEPT, NEAR

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import DoorConfig
    from hiermap_cli.mapping.portals import Portal
    from hiermap_cli.mapping.topology.trace import Trace

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

SAMPLE = 0.12  # metres of path between the points at which its width is taken
LAG = 0.3  # metres of path beyond a point before its width is taken
BESIDE = 0.4  # metres of path within which a narrow place is the narrowest, and told once
# Metres across the line and radians by which a frame is moved to lie along walls, in two rounds.
COARSE = tuple((0.0, 0.2 * k) for k in (0, 1, -1, 2, -2, 3, -3))
FINE = tuple((offset, 0.1 * k) for offset in (0.0, 0.1, -0.1) for k in (0, 1, -1))
BIN = 0.1  # metres of the line beside a jamb that are judged together
BINS = 12
THICKNESS = 0.22  # metres off the line at which a beam's end still belongs to the wall
BEYOND = 0.3  # metres behind the line that a beam must reach to have passed it
ASIDE = 0.35  # metres beside the jambs that a path through them may seem to be
STRAIGHT = 0.5  # sine of the angle between the line and a path that crosses it
STAND_OFF = 0.25  # metres off the line from which it is judged


@dataclass(slots=True)
class PassageDetector:
    """Takes the width of the path as the robot goes, and tells narrow places it has passed."""

    config: DoorConfig
    at: list[float] = field(default_factory=list)
    width: list[float] = field(default_factory=list)
    jambs: list[Array] = field(default_factory=list)
    heading: list[Array] = field(default_factory=list)
    asked: float = 0.0  # metres of path up to which doors that people hid have been asked for
    _next: float = SAMPLE
    _last: float = 0.0

    def forget_before(self, travelled: float) -> None:
        """Nothing that was passed before is told any more."""
        self._last = travelled

    def rewind(self, travelled: float) -> None:
        """The path from there on was another one than was taken."""
        cut = bisect_right(self.at, travelled)
        for kept in (self.at, self.width, self.jambs, self.heading):
            del kept[cut:]
        self._next = self.at[-1] + SAMPLE if self.at else max(travelled, 0.0) + SAMPLE
        self._last, self.asked = min(self._last, travelled), min(self.asked, travelled)

    def clear(self, travelled: float) -> None:
        """As if the path began there."""
        self.at, self.width, self.jambs, self.heading = [], [], [], []
        self._next, self._last = travelled + SAMPLE, travelled

    def move(self, R_b_a: Array) -> None:
        """Into the frame of another area; see `Trace.move`."""
        c, s = np.cos(R_b_a[2]), np.sin(R_b_a[2])
        turn = np.array([[c, s], [-s, c]])
        self.jambs = [R_b_a[:2] + jambs @ turn for jambs in self.jambs]
        self.heading = [heading @ turn for heading in self.heading]

    def passed(self, trace: Trace) -> Passage | None:
        """The next narrow place that now lies behind the robot, if there is one."""
        taken = False
        while self._next <= trace.length - LAG:
            self._take(trace, self._next)
            self._next += SAMPLE
            taken = True
        return self._narrowest(trace) if taken else None

    def _take(self, trace: Trace, s: float) -> None:
        if len(trace.poses) < 2:
            return
        point, heading = trace.at(s)
        recent = bisect_left(trace.travelled, s - NEAR)
        most = self.config.max_width + WIDER + self.config.widening
        ends = trace.near.since(recent)
        width, jambs = narrowest_chord(point, ends, most)
        way = trace.way.since(0)
        crossed = width <= most and all(went_over(jamb, way) for jamb in jambs)
        if width < self.config.min_width or crossed:
            # No robot goes through there: who walks before it is on its path, and no jamb.
            ends = ends[~gone_over(ends, way)]
            width, jambs = narrowest_chord(point, ends, most)
        self.at.append(s)
        self.width.append(width)
        self.jambs.append(jambs)
        self.heading.append(heading)
        if len(self.at) > 3 * self.config.reach / SAMPLE + 20:
            for kept in (self.at, self.width, self.jambs, self.heading):
                del kept[0]

    def _narrowest(self, trace: Trace) -> Passage | None:
        c = self.config
        if len(self.at) < 8:
            return None
        if min(self.width) > c.max_width + WIDER:
            return None
        at, width = self.at, self.width
        first = bisect_right(at, max(at[-1] - longest_reach(c), self._last))
        last = bisect_right(at, at[-1] - BESIDE)
        i = min(range(first, last), key=width.__getitem__, default=-1)
        if i < 0 or not c.min_width <= width[i] <= c.max_width + WIDER:
            return None
        reach = reach_of(width[i], c)
        before = width[bisect_left(at, at[i] - reach) : i]
        after = width[i + 1 : bisect_right(at, at[i] + reach)]
        near = width[bisect_left(at, at[i] - BESIDE) : bisect_right(at, at[i] + BESIDE)]
        if not before or width[i] > min(near):
            return None
        if min(max(before), max(after)) < width[i] + c.widening:
            return None
        frame = chord_frame(self.jambs[i], self.heading[i])
        if not _crossed(frame, self.heading[i], trace):
            return None
        self._last = at[i] + BESIDE
        found = passage_between(self.jambs[i], self.heading[i], width[i], at[i], trace)
        if width[i] > c.max_width and (found is None or not is_door(found, c)):
            return None
        return found


def passage_between(
    jambs: Array, heading: Array, width: float, travelled: float, trace: Trace
) -> Passage | None:
    """The narrow place between two jambs (2, 2), passed at so many metres of path that way (2,).

    None where the robot has not clearly gone through, or only come back.
    """
    frame = chord_frame(jambs, heading)
    if not _crossed(frame, heading, trace) or _came_by(frame, width, trace, travelled):
        return None
    frame, wall, opened = aligned(frame, width, *trace.rays(travelled - 4.0))
    return Passage(frame, width, travelled, wall, opened)


def crossed_again(p: Portal, door: Array, trace: Trace) -> Portal:
    """A portal with the evidence of one crossing more, the mean of all; its door's frame (3,)."""
    n = p.crossings
    if p.kind == "door":
        _, wall, opened = aligned(door, p.width, *trace.rays(trace.length - KEPT))
        p = replace(
            p,
            wall=(n * p.wall + float(wall.sum())) / (n + 1),
            open=(n * p.open + float(opened.sum())) / (n + 1),
        )
    return replace(p, crossings=n + 1)


def _crossed(frame: Array, heading: Array, trace: Trace) -> bool:
    """Whether the robot is beyond the line, and has not merely gone along it."""
    if se2.between(frame, trace.poses[-1])[1] < STAND_OFF:
        return False
    return bool(abs(np.sin(np.arctan2(*heading[::-1]) - frame[2])) >= STRAIGHT)


def _came_by(frame: Array, width: float, trace: Trace, travelled: float) -> bool:
    """Whether the robot, just before, went the other way between the jambs: it is only back."""
    since = int(np.searchsorted(trace.travelled, trace.entered))
    until = int(np.searchsorted(trace.travelled, travelled))
    if until - since < 2:
        return False
    u, v, _ = se2.between(frame, np.array(trace.poses[since:until])).T
    over = np.flatnonzero((v[:-1] > 0.0) & (v[1:] <= 0.0))
    return bool(np.any(np.abs(u[over]) < 0.5 * width + ASIDE))


def aligned(frame: Array, width: float, origins: Array, ends: Array) -> tuple[Array, Array, Array]:
    """The frame turned and moved a little so that most wall and least opening lies on its line.

    Returns it with metres of wall and of opening beside each jamb.
    """
    origins, ends = _about(frame, 0.5 * width + BIN * BINS + 0.8, origins, ends)
    best = (-np.inf, frame, np.zeros(2), np.zeros(2))
    middle, tried = (0.0, 0.0), set()
    for steps in (COARSE, FINE):
        about = middle
        for offset, turn in steps:
            move = (round(about[0] + offset, 3), round(about[1] + turn, 3))
            if move in tried:
                continue
            tried.add(move)
            moved = se2.compose(frame, np.array([0.0, *move]))
            wall, opened = line_evidence(moved, width, origins, ends)
            score = wall.sum() - opened.sum() - 0.2 * abs(move[1])
            if score > best[0]:
                best, middle = (score, moved, wall, opened), move
    return best[1], best[2], best[3]


def _about(frame: Array, radius: float, origins: Array, ends: Array) -> tuple[Array, Array]:
    """The beams that come within `radius` of the frame's origin, in columns."""
    (ox, oy), (dx, dy) = (origins - frame[:2]).T, (ends - origins).T
    t = -(ox * dx + oy * dy) / np.maximum(dx * dx + dy * dy, 1e-12)
    t = t.clip(0.0, 1.0)
    x, y = ox + t * dx, oy + t * dy
    near = (x * x + y * y < radius * radius).nonzero()[0]
    return origins.T.take(near, axis=1).T, ends.T.take(near, axis=1).T


def line_evidence(frame: Array, width: float, origins: Array, ends: Array) -> tuple[Array, Array]:
    """Metres (2,) of the line beside each jamb that are wall, and that beams have passed.

    A piece of the line is wall where beams end on it and (nearly) none passes, open where more
    pass than end; where no beam comes it is neither.
    """
    x, y, theta = frame.tolist()
    c, s = math.cos(theta), math.sin(theta)
    u, v = c * x + s * y, c * y - s * x
    (ox, oy), (ex, ey) = origins.T, ends.T
    before, after = c * oy - s * ox - v, c * ey - s * ex - v
    off, left = np.abs(before) > STAND_OFF, np.abs(after)
    on_line = (off & (left < THICKNESS)).nonzero()[0]
    through = (off & (left > BEYOND) & (before * after < 0.0)).nonzero()[0]
    hits = _counts(c * ex[on_line] + s * ey[on_line] - u, width)
    before, after = before[through], after[through]
    ox, oy, ex, ey = ox[through], oy[through], ex[through], ey[through]
    f = before / (before - after)
    passes = _counts(c * (ox + f * (ex - ox)) + s * (oy + f * (ey - oy)) - u, width)
    wall = BIN * ((hits >= 2) & (3 * passes <= hits)).sum(axis=1)
    opened = BIN * ((passes >= 2) & (passes > hits)).sum(axis=1)
    return wall, opened


def _counts(along: Array, width: float) -> Index:
    """How many of these places (n,) along the line are in each bin beside the jambs, (2, BINS)."""
    bins = (np.abs(along) - 0.5 * width) / BIN
    inside = ((bins >= 0.0) & (bins < BINS)).nonzero()[0]
    at = bins[inside].astype(np.int64) + BINS * (along[inside] > 0.0)
    return np.bincount(at, minlength=2 * BINS).reshape(2, BINS)
