"""Odometry that has lost the sign of backward motion, found out by the walls.

Some robots' drivers tell how far the wheels have turned and not which way: where the robot backs
up, its odometry goes on ahead. A robot can only change its direction where it all but stands
still, so from each such *turning point* on there are two hypotheses: translations are as they
are told, or the other way round. As long as the walls fit what is told, that is all; where they
cease to fit and have not confirmed the direction since the last turning point, the area is
filtered once more from there with translations reversed (states are values, and the scans since
are kept), and both hypotheses go on side by side until one explains the walls clearly better.
The same holds the other way round for the end of a reversed stretch. Where nothing lies across
the direction of travel both explain the walls alike, and what is told stands.

The measure is the negative log-likelihood (times two, but for what the hypotheses have in
common) of all segments since the fork: the NIS of those that match, the gate's chi-square for
each that does not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.association.matching import MAX_SEGMENTS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.estimation.stochastic_map import Motion
    from hiermap_cli.mapping.area_map import AreaMap
    from hiermap_cli.mapping.association.area_filter import Step
    from hiermap_cli.mapping.odometry.stepping import Stepper
    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]

AT_ONCE = 3  # hypotheses beside what is told


class Leg(NamedTuple):
    """What came since the last key scan, n scans with the key scan at the end.

    stamps_ns: (n,). raw: (n, 3) the odometry since the last key scan as it is told. slowest: the
    scan before whose step the robot was slowest; turning: whether it may have turned about there.
    """

    stamps_ns: tuple[int, ...]
    raw: Array
    slowest: int
    turning: bool


class Drive(NamedTuple):
    """How the robot came from key scan to key scan, as it is believed.

    increments: (n, 3) as `Leg.raw`. motion: the last of them calibrated. trusted: False where
    odometry has failed. before: the area before it.
    """

    leg: Leg
    increments: Array
    motion: Motion
    trusted: bool
    before: AreaMap


class Told(NamedTuple):
    """A drive and the key scan after it, as a hypothesis has them.

    cost: of all of them since the window's beginning, this one too.
    """

    drive: Drive
    key: int
    view: SegmentView
    step: Step
    cost: float


class Branch(NamedTuple):
    """The hypothesis that translations go the other way from `since_ns` on, and how it went on."""

    since_ns: int
    told: tuple[Told, ...]

    @property
    def cost(self) -> float:
        """Up to now."""
        return self.told[-1].cost

    def path(self) -> float:
        """Metres since the turning point."""
        first = self.told[0].drive
        at = first.leg.slowest
        there = first.increments[at] if at >= 0 else np.zeros(3)
        length = math.dist(there[:2], first.increments[-1, :2])
        for one in self.told[1:]:
            length += math.hypot(*one.drive.increments[-1, :2].tolist())
        return length


@dataclass(slots=True)
class DirectionWatch:
    """Weighs whether odometry tells the direction of motion truly.

    sign: 1 as told, -1 while translations are taken the other way round.
    """

    stepper: Stepper
    sign: float = 1.0
    _base: Array | None = None
    _at: Array | None = None
    _last: tuple[int, float, float] = (0, 0.0, 0.0)
    _stamps: list[int] = field(default_factory=list)
    _raw: list[Array] = field(default_factory=list)
    _slowest: tuple[float, int] = (math.inf, 0)  # m/s, negative where the sign has changed
    _ahead: float = 0.0
    _window: list[Told] = field(default_factory=list)
    _branches: list[Branch] = field(default_factory=list)
    _suspected: bool = False
    _path: float = 0.0
    _shown: float = 0.0
    _told_backward: float = 0.0

    def come(self, stamp_ns: int, odometry: Array) -> Array:
        """The next scan's odometry: the increment (3,) since the last key scan, as believed."""
        x, y, theta = odometry.tolist()
        if self._base is None:
            self._base, self._last = odometry, (stamp_ns, x, y)
        last_ns, last_x, last_y = self._last
        seconds = max(stamp_ns - last_ns, 1) * 1e-9
        speed = math.hypot(x - last_x, y - last_y) / seconds
        ahead = (x - last_x) * math.cos(theta) + (y - last_y) * math.sin(theta)
        if speed < self._slowest[0]:
            self._slowest = speed, len(self._raw)
        if ahead * self._ahead < 0.0 and self._slowest[0] >= 0.0:
            self._slowest = -1.0, len(self._raw) - 1
        self._ahead = ahead
        self._last, self._at = (stamp_ns, x, y), odometry
        self._stamps.append(stamp_ns)
        raw = se2.between(self._base, odometry)
        if speed > self.stepper.config.odometry_faults.turning_speed:
            self._told_backward += max(-ahead, 0.0)
        self._raw.append(raw)
        return raw if self.sign > 0.0 else reversed_(raw)

    def stamp_ns(self) -> int:
        """Stamp of the last scan that came."""
        return self._last[0]

    def leg(self, increment: Array) -> tuple[Leg, Array]:
        """What came since the last key scan, and as it is believed.

        The last scan that came is a key scan, to which the robot has come by `increment`.
        """
        speed, at = self._slowest
        turning = speed < self.stepper.config.odometry_faults.turning_speed
        leg = Leg(tuple(self._stamps), np.array(self._raw), at, turning)
        believed = leg.raw if self.sign > 0.0 else reversed_(leg.raw)
        believed[-1] = increment
        self._base = self._at
        self._stamps, self._raw, self._slowest = [], [], (math.inf, 0)
        return leg, believed

    def weigh(self, drive: Drive, key: int, view: SegmentView, step: Step) -> Branch | None:
        """Takes in a drive and its key scan; another hypothesis of it if that is clearly better."""
        c = self.stepper.config.odometry_faults
        turning = drive.leg.turning
        if not drive.trusted or self._signed(drive):
            self.forget()
            return None
        suspicious = self._suspicious(step)
        if not self._window and not turning and (self.sign > 0.0 or not suspicious):
            return None
        so_far = self._window[-1].cost if self._window else 0.0
        told = Told(drive, key, view, step, so_far + self.stepper.misfit(step))
        self._window.append(told)
        self._path += math.hypot(*drive.increments[-1, :2].tolist())
        self._branches = [self._further(branch, told) for branch in self._branches]
        if suspicious and not self._suspected:
            self._suspected = True
            self._branches = [self._fork(i) for i in self._turns()[-AT_ONCE:]]
        elif turning and (self._suspected or self.sign < 0.0):
            self._branches.append(self._fork(len(self._window) - 1))
        best = self._best(told.cost)
        if best is not None and self._convincing(best, told):
            return best
        if self._sound(step):
            self._shown += would_show(told)
        if best is not None and self.sign < 0.0 and best.path() > c.max_backward:
            return best
        over = self._path > c.max_path or len(self._window) > c.max_keys
        if over or (best is None and self._shown > c.shown):
            self.forget()
        return None

    def _signed(self, drive: Drive) -> bool:
        """Whether odometry has told so much of backing up that what it tells ahead is ahead."""
        told = self._told_backward > self.stepper.config.odometry_faults.signed
        return told and self.sign > 0.0 and float(drive.increments[-1, 0]) > 0.0

    def take(self, branch: Branch) -> None:
        """The branch is what is believed from now on; later turning points in it stay open."""
        self.forget()
        self.sign = -self.sign
        told = branch.told
        later = [i for i, one in enumerate(told) if i and one.drive.leg.turning]
        if later:
            base = told[later[0] - 1].cost
            self._window = [one._replace(cost=one.cost - base) for one in told[later[0] :]]
            self._path = sum(
                math.hypot(*one.drive.increments[-1, :2].tolist()) for one in self._window
            )

    def forget(self) -> None:
        """Nothing before now is open any more."""
        self._window, self._branches = [], []
        self._suspected, self._path, self._shown = False, 0.0, 0.0

    def _convincing(self, best: Branch, told: Told) -> bool:
        """Whether a branch explains the walls clearly better than what is told.

        Where the walls show that the robot has just come as told, what costs so much is something
        else: outliers, which a branch that knows only walls along its way is merely rid of.
        Ahead again after a while of driving backwards is believed sooner than the contrary.
        Odometry that has told of backing up has probably not lost its sign, and what it tells
        of backing up is probably true.
        """
        c = self.stepper.config.odometry_faults
        cost = told.cost
        if best.path() < c.min_path:
            return False
        if self._sound(told.step) and favours(told) > favours(best.told[-1]):
            return False
        if self.sign < 0.0:
            return best.cost < cost - c.clear / 3.0
        ahead = sum(float(one.drive.increments[-1, 0]) for one in best.told) < 0.0
        signed = ahead and self._told_backward > c.backward
        clear = c.clear * (3.0 if signed else 1.0 if ahead else 2.0)
        since = best.cost - (best.told[0].cost - self.stepper.misfit(best.told[0].step))
        return best.cost < cost - clear - c.share * since

    def _turns(self) -> list[int]:
        """The drives of the window in which the robot may have turned about."""
        turns = [i for i, one in enumerate(self._window) if one.drive.leg.turning]
        return turns or [len(self._window) - 1]

    def _best(self, cost: float) -> Branch | None:
        """The best branch, after those that are clearly worse than `cost` are dropped."""
        clear = self.stepper.config.odometry_faults.clear * (3.0 if self.sign < 0.0 else 1.0)
        good = [branch for branch in self._branches if branch.cost < cost + clear]
        self._branches = sorted(good, key=lambda branch: branch.cost)[:AT_ONCE]
        return self._branches[0] if self._branches else None

    def _further(self, branch: Branch, told: Told) -> Branch:
        """The branch with one drive more."""
        increments = reversed_(told.drive.increments)
        return Branch(
            branch.since_ns, (*branch.told, self._filtered(told, branch.told[-1], increments))
        )

    def _fork(self, i: int) -> Branch:
        """The other direction from the turning point of the window's drive i on, up to now."""
        first = self._window[i]
        at = first.drive.leg.slowest
        increments = turned_from(first.drive.increments, at)
        before = first.cost - self.stepper.misfit(first.step)
        told = [self._filtered(first, None, increments)]
        told[0] = told[0]._replace(cost=told[0].cost + before)
        for one in self._window[i + 1 :]:
            told.append(self._filtered(one, told[-1], reversed_(one.drive.increments)))
        return Branch(first.drive.leg.stamps_ns[max(at, 0)], tuple(told))

    def _filtered(self, one: Told, last: Told | None, increments: Array) -> Told:
        """A drive of the window with other increments, after `last` of a branch (or as it was).

        Where the robot turns about just now nothing has gone the other way yet: the step is the
        one that is told.
        """
        now = last is None and one is self._window[-1]
        if now and np.array_equal(increments, one.drive.increments):
            return one._replace(cost=self.stepper.misfit(one.step))
        before = one.drive.before if last is None else last.step.area
        motion, step = self.stepper.filtered(before, increments[-1], one.view, one.key)
        cost = self.stepper.misfit(step) + (0.0 if last is None else last.cost)
        drive = one.drive._replace(increments=increments, motion=motion, before=before)
        return Told(drive, one.key, one.view, step, cost)

    def _sound(self, step: Step) -> bool:
        """Whether so much of a scan matches that the walls tell where the robot is."""
        c = self.stepper.config.odometry_faults
        return len(step.matches.wall) >= min(c.sound_share * step.offered, MAX_SEGMENTS)

    def _suspicious(self, step: Step) -> bool:
        """Whether the walls fit ill enough for a fault to be looked for."""
        c = self.stepper.config.odometry_faults
        ill = len(step.matches.wall) < min(c.poor_share * step.offered, MAX_SEGMENTS - 1)
        return bool(ill or (step.degrees and step.nis > c.poor_nis * step.degrees))


def would_show(told: Told) -> float:
    """By how much chi-square would grow if the last motion had gone the other way.

    The update took `D` off the variance `v` of the robot's place along its motion: it measured it
    with a variance of `v^2 / D` about what was predicted.
    """
    v, D = _measured(told)
    return 4.0 * float(told.drive.increments[-1, 0]) ** 2 * D / v**2


def favours(told: Told) -> float:
    """By how much the walls favour the last motion over the other way, as a chi-square.

    As `would_show`, but about where the walls have moved the robot to: with the step `d` between
    prediction and measurement, `((d + 2 a)^2 - d^2) D / v^2` for a motion of `a` ahead. The update
    itself went by `d D / v`. Negative where the walls speak for the other way.
    """
    v, _ = _measured(told)
    came = se2.between(told.drive.before.V.robot, told.step.area.V.robot)
    off = float(came[0] - told.drive.motion.pose[0])
    return would_show(told) + 4.0 * float(told.drive.increments[-1, 0]) * off / v


def _measured(told: Told) -> tuple[float, float]:
    """The variance of the robot's place along its motion, and what the update took off it."""
    V, P = told.step.area.V, told.drive.before.V.covariance
    along = (se2.adjoint(se2.invert(V.robot)) @ V.invariant_D_error(V.robot))[0]
    v = float(along @ P[:3, :3] @ along + told.drive.motion.covariance[0, 0])
    return v, max(v - float(along @ V.covariance[:3, :3] @ along), 0.0)


def reversed_(increments: Array) -> Array:
    """Increments (n, 3) with translations the other way round: headings are told truly."""
    return np.asarray(increments * np.array([-1.0, -1.0, 1.0]))


def turned_from(increments: Array, first: int) -> Array:
    """Increments (n, 3) since one place, whose steps go the other way after the first ones."""
    out = increments.copy()
    if first < 0:
        return reversed_(out)
    if first + 1 < len(out):
        there = increments[first]
        after = se2.between(there, increments[first + 1 :])
        out[first + 1 :] = se2.compose(there, reversed_(after))
    return out
