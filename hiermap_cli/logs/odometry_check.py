"""What is suspicious in a log's odometry: jumps, wrong units, a lost sign, no motion at all."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.logs.decimals import ns_to_seconds
from hiermap_cli.logs.gaps import Intervals

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

BATCH = 4096  # readings looked at together

_MOVED = 0.002  # metres of a step that count as motion
_CLEAR = 0.02  # metres of a step whose direction says something
_FAST = 5.0  # metres a second: faster than any robot that drives indoors
_JUMP = (0.2, 2.5)  # metres, and metres a second, beyond which a step is a jump
_TURN_JUMP = (0.35, 4.0)  # radians, and radians a second
_SIDE_JUMP = (0.15, 0.25)
_LONG_PATH = 10.0  # metres without ever driving backwards that are worth a word


class Jump(NamedTuple):
    """A step of odometry that no robot makes."""

    at_ns: int
    metres: float
    radians: float


class OdometryCheck:
    """Watches the readings in the order of time, in constant memory."""

    def __init__(self) -> None:
        self._batch: list[tuple[int, float, float, float]] = []
        self.intervals = Intervals()
        self.readings = 0
        self.path = 0.0
        self.turned = 0.0
        self.jumps: list[Jump] = []
        self.jump_count = 0
        self._backward = self._moving = self._fast = 0
        self._sideways: list[float] = []
        self._side_count = 0
        self._clear = 0
        self._agree_radians = self._agree_degrees = 0.0

    def add(self, time_ns: int, x: float, y: float, theta: float) -> None:
        """The next reading; its heading not wrapped."""
        self._batch.append((time_ns, x, y, theta))
        if len(self._batch) > BATCH:
            self._flush()

    def _flush(self) -> None:
        """Works the batch off; its last reading begins the next one."""
        if not self._batch:
            return
        stamps_ns = np.array([reading[0] for reading in self._batch], dtype=np.int64)
        poses = np.array([reading[1:] for reading in self._batch], dtype=np.float64)
        new = stamps_ns if self.readings == 0 else stamps_ns[1:]
        self.readings += len(new)
        self.intervals.add(new)
        self._batch = self._batch[-1:]
        if len(poses) > 1:
            self._steps(stamps_ns, poses)

    def _steps(self, stamps_ns: NDArray[np.int64], poses: Array) -> None:
        seconds = np.maximum(np.diff(stamps_ns) * 1e-9, 0.0)
        step = np.diff(poses, axis=0)
        turn = np.remainder(step[:, 2] + math.pi, 2.0 * math.pi) - math.pi
        heading = poses[:-1, 2] + 0.5 * turn
        c, s = np.cos(heading), np.sin(heading)
        ahead = c * step[:, 0] + s * step[:, 1]
        aside = np.abs(c * step[:, 1] - s * step[:, 0])
        length = np.hypot(step[:, 0], step[:, 1])
        self.path += float(length.sum())
        self.turned += float(np.abs(turn).sum())
        moving = length > _MOVED
        self._moving += int(moving.sum())
        self._fast += int((length > _FAST * seconds + _MOVED)[moving].sum())
        along = moving & (np.abs(ahead) > aside)
        self._backward += int((ahead[along] < 0.0).sum())
        self._note_jumps(stamps_ns, seconds, length, turn)
        side = aside > _SIDE_JUMP[0] + _SIDE_JUMP[1] * seconds
        self._side_count += int(side.sum())
        self._sideways = sorted((*self._sideways, *aside[side].tolist()))[-3:]
        self._note_direction(poses[:-1, 2], step, length, turn)

    def _note_jumps(
        self, stamps_ns: NDArray[np.int64], seconds: Array, length: Array, turn: Array
    ) -> None:
        far = length > _JUMP[0] + _JUMP[1] * seconds
        around = np.abs(turn) > _TURN_JUMP[0] + _TURN_JUMP[1] * seconds
        places = np.flatnonzero(far | around)
        self.jump_count += len(places)
        found = [Jump(int(stamps_ns[i + 1]), float(length[i]), float(turn[i])) for i in places]
        # The worst ones are kept.
        self.jumps = sorted((*self.jumps, *found), key=_size)[-5:]

    def _note_direction(self, heading: Array, step: Array, length: Array, turn: Array) -> None:
        """Does the robot drive where its heading points, read as radians or as degrees?"""
        clear = (length > _CLEAR) & (np.abs(step[:, 2]) < 20.0)
        course = np.arctan2(step[clear, 1], step[clear, 0])
        radians = heading[clear] + 0.5 * turn[clear]
        degrees = np.radians(heading[clear] + 0.5 * step[clear, 2])
        self._clear += int(clear.sum())
        self._agree_radians += float(np.abs(np.cos(course - radians)).sum())
        self._agree_degrees += float(np.abs(np.cos(course - degrees)).sum())

    @property
    def never_backward(self) -> bool:
        """Whether a path that is long enough to tell has no step backwards."""
        return self._backward == 0 and self.path > _LONG_PATH

    def warnings(self, *, sign_is_lost: bool = False) -> list[str]:
        """What a person should know, worst first; `sign_is_lost`: the scans have told so."""
        self._flush()
        out = []
        if self._moving > 20 and self._fast > 0.5 * self._moving:
            out.append(
                f"odometry moves {self.path:.0f} m in steps faster than {_FAST:.0f} m/s: its "
                "lengths look like centimetres, not metres"
            )
        elif self.jump_count:
            worst = self.jumps[-1]
            out.append(
                f"odometry jumps {_times(self.jump_count)}, at worst by {worst.metres:.2f} m and "
                f"{math.degrees(worst.radians):.0f} degrees at {ns_to_seconds(worst.at_ns)} s"
            )
        if self._clear > 20:
            radians, degrees = self._agree_radians / self._clear, self._agree_degrees / self._clear
            if degrees > 0.97 and radians < 0.9:
                out.append("odometry drives where its heading in degrees points, not in radians")
        if 0 < self._side_count < 0.05 * max(self._moving, 1):
            out.append(
                f"odometry steps sideways {_times(self._side_count)}, by up to "
                f"{self._sideways[-1]:.2f} m"
            )
        if self.never_backward and not sign_is_lost:
            out.append(
                f"odometry never goes backwards over {self.path:.0f} m: the sign of reverse "
                "motion may be lost, if the robot ever backed up"
            )
        if self.readings > 50 and self.path < 0.01 and self.turned < 0.01:
            out.append(f"odometry does not move in {self.readings} readings")
        gaps = self.intervals.gaps()
        if gaps:
            out.append(
                f"odometry is silent for {gaps[0].seconds:.1f} s at "
                f"{ns_to_seconds(gaps[0].at_ns)} s (every {self.intervals.median():.3f} s else)"
            )
        return out


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _size(jump: Jump) -> float:
    return jump.metres + abs(jump.radians)
