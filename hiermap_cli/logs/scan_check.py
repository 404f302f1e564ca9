"""What is suspicious in the scans: units, silence, and whether they move as odometry says.

When the robot turns left, what it sees turns right by as much; when it drives forward, what is
ahead comes nearer. Scans that do the contrary come from a laser that is mirrored or looks to
the rear without the log saying so, or meet an odometry whose sign is lost.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry.se2 import between
from hiermap_cli.logs.decimals import ns_to_seconds
from hiermap_cli.logs.gaps import Intervals

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.logs.records import LaserGeometry, Mount, ScanBlock

    Ranges = NDArray[np.float32]

_PAIRS = 12  # pairs of scans of each kind that are looked at in a block
_TURNS = (0.05, 0.5)  # radians between two scans that show which way the scans turn
_DRIVES = (0.04, 0.6)  # metres between two scans that show which way the scans move
_STILL = 0.02  # metres, or radians, that do not disturb the other test
_NEAR = 15.0  # metres; farther returns are cut to it in comparisons
_AHEAD = 0.35  # radians on either side of straight ahead
_VOTES = 8  # pairs that must speak before anything is said
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
        turning = known & (turn > _TURNS[0]) & (turn < _TURNS[1]) & (distance < _STILL)
        driving = known & (distance > _DRIVES[0]) & (distance < _DRIVES[1]) & (turn < _STILL)
        for i in _some(turning):
            vote = turns_as_expected(
                block.ranges[i], block.ranges[i + 1], float(motion[i, 2]), block.laser,
                flipped=self._mount.flipped,
            )  # fmt: skip
            if vote is not None:
                self._turn_votes[0 if vote else 1] += 1
        angles = beam_directions(block.laser, self._mount)
        ahead, behind = np.abs(_wrap(angles)) < _AHEAD, np.abs(_wrap(angles - np.pi)) < _AHEAD
        moved = np.flatnonzero(driving)
        if len(moved) and (ahead.any() or behind.any()):
            right, wrong = drive_votes(block.ranges, moved, motion[moved, 0], ahead, behind)
            self._drive_votes[0] += right
            self._drive_votes[1] += wrong

    def median_range(self) -> float:
        """Metres; 0 where nothing was seen."""
        return float(np.median(self._medians)) if self._medians else 0.0

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
        elif never_backward and wrong >= _VOTES:
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


def turns_as_expected(
    before: Ranges, after: Ranges, turn: float, laser: LaserGeometry, *, flipped: bool
) -> bool | None:
    """Whether the scan turned as a robot does that turns by `turn` (radians); None if unclear."""
    shift = round(turn / laser.angle_increment) * (-1 if flipped else 1)
    if not 0 < abs(shift) < len(before) // 2:
        return None
    expected, contrary = _misfit(before, after, shift), _misfit(before, after, -shift)
    if min(expected, contrary) > 0.6 * max(expected, contrary):
        return None
    return expected < contrary


def _misfit(before: Ranges, after: Ranges, shift: int) -> float:
    """Median difference of `after[i]` and `before[i + shift]`, in metres."""
    near_before, near_after = _clipped(before), _clipped(after)
    if shift > 0:
        near_before, near_after = near_before[shift:], near_after[:-shift]
    else:
        near_before, near_after = near_before[:shift], near_after[-shift:]
    difference = np.abs(near_before - near_after)
    difference = difference[np.isfinite(difference)]
    # Where most beams agree either way, the tail tells the two apart.
    return float(np.mean(np.minimum(difference, 1.0))) if len(difference) > 8 else np.inf


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
