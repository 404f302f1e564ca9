"""What is suspicious in the scans: units, silence, and whether they move as odometry says.

When the robot turns left, what it sees turns right by as much; when it drives forward, what is
ahead comes nearer. Scans that do the contrary come from a laser that is mirrored or looks to
the rear without the log saying so, or meet an odometry whose sign is lost.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry.points import h
from hiermap_cli.geometry.se2 import between, compose, invert
from hiermap_cli.logs.decimals import ns_to_seconds
from hiermap_cli.logs.gaps import Intervals

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.logs.records import LaserGeometry, Mount, ScanBlock

    Ranges = NDArray[np.float32]

_PAIRS = 12  # pairs of scans of each kind that are looked at in a block
_TURNS = (0.05, 0.5)  # radians between two scans that show which way the scans turn
_DRIVES = (0.04, 0.6)  # metres between two scans that show which way the scans move
_BENDS = 0.08  # metres that tell forward from backward in bends, and where scans are far apart
_FAR = 1.5  # metres beyond which two scans have too little in common
_STILL = 0.02  # radians that do not disturb the test of driving
_NEAR = 15.0  # metres; farther returns are cut to it in comparisons
_AHEAD = 0.35  # radians on either side of straight ahead
_CLEAR = 0.6  # of the worse fit, at most, where one is better
_VOTES = 8  # pairs that must speak before anything is said
_ENOUGH = 60  # votes after which no more pairs are asked: a mount stays as it is
_MOST = 0.8
_CENTIMETRES = 40.0  # metres; a median range beyond is none


class ScanCheck:
    """Watches the blocks, in constant memory."""

    def __init__(self, mount: Mount) -> None:
        self.intervals = Intervals()
        self._mount = mount
        self._turn_votes = [0, 0]  # as expected, the other way round
        self._drive_votes = [0, 0]
        self._medians: list[float] = []
        self.scans = 0
        self.beams_seen = 0
        self.beams_far = 0
        self.beams_silent = 0
        self.first_ns: int | None = None
        self.last_ns = 0

    def add(self, block: ScanBlock) -> None:
        """The next block."""
        if self.first_ns is None:
            self.first_ns = int(block.stamps_ns[0])
        self.last_ns = int(block.stamps_ns[-1])
        self.scans += len(block)
        self.intervals.add(block.stamps_ns)
        silent = int(np.isnan(block.ranges).sum())
        far = int(np.isposinf(block.ranges).sum())
        seen = block.ranges.size - silent - far
        self.beams_silent += silent
        self.beams_far += far
        self.beams_seen += seen
        if seen and len(self._medians) < 1000:
            some = block.ranges[:: max(1, len(block) // 8)]
            finite = some[np.isfinite(some)]
            if len(finite):
                self._medians.append(float(np.median(finite)))
        if len(block) > 1 and block.laser.beams > 8:
            self._compare(block)

    def _compare(self, block: ScanBlock) -> None:
        motion = between(block.odometry[:-1], block.odometry[1:])
        known = block.has_odometry[:-1] & block.has_odometry[1:]
        distance = np.hypot(motion[:, 0], motion[:, 1])
        turn = np.abs(motion[:, 2])
        turning = known & (turn > _TURNS[0]) & (turn < _TURNS[1]) & (distance < _FAR)
        driving = known & (distance > _DRIVES[0]) & (distance < _DRIVES[1]) & (turn < _STILL)
        bending = known & (distance > _BENDS) & (distance < _FAR) & (turn < _TURNS[1]) & ~driving
        if sum(self._turn_votes) < _ENOUGH:
            for i in _some(turning):
                self._vote(self._turn_votes, fits(block, i, motion[i], self._mount).mirrored())
        if sum(self._drive_votes) < _ENOUGH:
            for i in _some(bending):
                self._vote(self._drive_votes, fits(block, i, motion[i], self._mount).rearward())
        angles = beam_directions(block.laser, self._mount)
        ahead, behind = np.abs(_wrap(angles)) < _AHEAD, np.abs(_wrap(angles - np.pi)) < _AHEAD
        moved = np.flatnonzero(driving)
        if len(moved) and (ahead.any() or behind.any()):
            right, wrong = drive_votes(block.ranges, moved, motion[moved, 0], ahead, behind)
            self._drive_votes[0] += right
            self._drive_votes[1] += wrong

    @staticmethod
    def _vote(votes: list[int], wrong: bool | None) -> None:
        if wrong is not None:
            votes[wrong] += 1

    def median_range(self) -> float:
        """Metres; 0 where nothing was seen."""
        return float(np.median(self._medians)) if self._medians else 0.0

    @property
    def backs_up(self) -> bool:
        """Whether the scans show the robot backing up, in steps that odometry tells otherwise."""
        right, wrong = self._drive_votes
        mirrored = right + wrong >= _VOTES and wrong > _MOST * (right + wrong)
        return wrong >= _VOTES and not mirrored

    def warnings(self, *, never_backward: bool) -> list[str]:
        """What a person should know; `never_backward` is what odometry says of itself."""
        out = []
        if self.median_range() > _CENTIMETRES:
            out.append(
                f"half of the ranges are beyond {self.median_range():.0f} m: they look like "
                "centimetres or millimetres"
            )
        right, wrong = self._turn_votes
        if right + wrong >= _VOTES and wrong > _MOST * (right + wrong):
            out.append(
                f"in {wrong} of {right + wrong} turns the scans turn the wrong way: the laser "
                "seems mirrored (see --mount x,y,yaw,flipped), or odometry's heading is"
            )
        right, wrong = self._drive_votes
        if right + wrong >= _VOTES and wrong > _MOST * (right + wrong):
            out.append(
                f"in {wrong} of {right + wrong} steps the scans move the wrong way: the laser "
                "seems to look to the rear (see --mount), or odometry's sign is wrong"
            )
        elif never_backward and self.backs_up:
            out.append(
                f"in {wrong} of {right + wrong} steps the scans show the robot backing up while "
                "odometry goes forward: the sign of reverse motion is lost"
            )
        gaps = self.intervals.gaps()
        if gaps:
            out.append(
                f"no scan for {gaps[0].seconds:.1f} s at {ns_to_seconds(gaps[0].at_ns)} s "
                f"(every {self.intervals.median():.3f} s else)"
            )
        return out


def _some(chosen: NDArray[np.bool_]) -> list[int]:
    places = np.flatnonzero(chosen)
    found: list[int] = places[:: max(1, -(-len(places) // _PAIRS))].tolist()
    return found


def beam_directions(laser: LaserGeometry, mount: Mount) -> NDArray[np.float64]:
    """Directions of the beams in the robot's frame, shape (beams,)."""
    return mount.yaw + (-laser.angles() if mount.flipped else laser.angles())


class Fits(NamedTuple):
    """How a scan fits the one before it, by metres of difference, if the laser is mounted so.

    As the log says; turned to the other side; mirrored; both.
    """

    stated: float
    turned: float
    flipped: float
    both: float

    def mirrored(self) -> bool | None:
        """Whether the laser is mirrored, against what the log says; None if unclear."""
        return _clearly(min(self.stated, self.turned), min(self.flipped, self.both))

    def rearward(self) -> bool | None:
        """Whether the laser looks the other way than the log says; None if unclear."""
        return _clearly(min(self.stated, self.flipped), min(self.turned, self.both))


def _clearly(expected: float, contrary: float) -> bool | None:
    if min(expected, contrary) > _CLEAR * max(expected, contrary):
        return None
    return contrary < expected


def fits(block: ScanBlock, i: int, motion: NDArray[np.float64], mount: Mount) -> Fits:
    """How scan i + 1 fits scan i and odometry's motion (3,) between the two."""
    other = mount.yaw + np.pi
    mounts = (
        mount,
        replace(mount, yaw=other),
        replace(mount, flipped=not mount.flipped),
        replace(mount, yaw=other, flipped=not mount.flipped),
    )
    return Fits(*(_misfit(block, i, motion, each) for each in mounts))


def _misfit(block: ScanBlock, i: int, motion: NDArray[np.float64], mount: Mount) -> float:
    """Mean difference of scan i + 1 to what scan i sees from there, each at most a metre."""
    laser = block.laser
    before = np.where(block.ranges[i] < _NEAR, block.ranges[i], np.nan).astype(np.float64)
    R_r_s = mount.pose()
    R_s0_s1 = compose(invert(R_r_s), compose(motion, R_r_s))
    beams = beam_directions(laser, mount) - mount.yaw
    points = np.stack((before * np.cos(beams), before * np.sin(beams)), axis=1)
    seen = h(invert(R_s0_s1), points)
    direction = np.arctan2(seen[:, 1], seen[:, 0]) * (-1.0 if mount.flipped else 1.0)
    step = laser.angle_increment
    beam = np.remainder((direction - laser.angle_min) * np.sign(step), 2.0 * np.pi) / abs(step)
    with np.errstate(invalid="ignore"):  # nan, of a beam that says nothing, is not below
        inside = beam < laser.beams - 0.5
    after = _clipped(block.ranges[i + 1])[np.rint(beam[inside]).astype(np.int64)]
    difference = np.abs(np.hypot(seen[inside, 0], seen[inside, 1]) - after)
    difference = difference[np.isfinite(difference)]
    # Where most beams agree either way, the tail tells the two apart.
    enough = len(difference) > max(8, laser.beams // 8)
    return float(np.mean(np.minimum(difference, 1.0))) if enough else np.inf


def _clipped(ranges: Ranges) -> Ranges:
    return np.minimum(ranges, np.float32(_NEAR))


def drive_votes(
    ranges: Ranges,
    moved: NDArray[np.int64],
    forward: NDArray[np.float64],
    ahead: NDArray[np.bool_],
    behind: NDArray[np.bool_],
) -> tuple[int, int]:
    """Pairs (scans i, i + 1 for i in `moved`) in which what is ahead came nearer, and farther.

    ranges: (B, beams); moved: (K,); forward: (K,) metres that odometry went; ahead, behind:
    (beams,) which beams look along the robot's path. Pairs that do not speak clearly, because
    too few beams do or because they moved by another distance, are in neither number.
    """
    with np.errstate(invalid="ignore"):  # inf less inf: nan, which says nothing
        nearer = np.hstack(
            (
                ranges[moved][:, ahead] - ranges[moved + 1][:, ahead],
                ranges[moved + 1][:, behind] - ranges[moved][:, behind],
            )
        )
        nearer[np.abs(nearer) > 2.0 * np.abs(forward)[:, None] + 0.1] = np.nan
    nearer.sort(axis=1)  # nan goes last
    usable = np.isfinite(nearer).sum(axis=1)
    median = nearer[np.arange(len(moved)), usable // 2]
    ratio = median / forward
    clear = (usable >= 8) & (np.abs(ratio) > 0.6) & (np.abs(ratio) < 1.5)
    return int((ratio[clear] > 0).sum()), int((ratio[clear] < 0).sum())


def _wrap(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi
