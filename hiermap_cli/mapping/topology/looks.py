"""What was seen of the free space, kept as long as the log lasts: to lay it anew at better poses.

While the log is read every area gathers its free space at the poses of the filter (`places`).
Where the filter's area was bent, or had a loop open inside, its free space is so too. The scans
that made it are therefore kept, each as the robot saw it, by the number of its key scan; when
all key poses are solved anew, the free space is made again from there.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.perception.sight import Sight

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

UNIT = 1e-3  # metres in which ends are kept: 16 bits reach 32 m, and sights end far before


class Looks(NamedTuple):
    """N scans of the path in the order of time, L of which were looked at.

    key, area: (N,) key scan and area of each scan. look: (L,) which of them were looked at.
    origin: (L, 2) the laser, and ends (m, 2) of all their beams in the robot's frame, `first`
    (L + 1,) telling whose they are.
    """

    key: Index
    area: Index
    look: Index
    origin: Array
    ends: Array
    first: Index


@dataclass(slots=True)
class LookRecord:
    """Scans as they come: half a kilobyte for each that is looked at."""

    _key: array[int] = field(default_factory=lambda: array("q"))
    _area: array[int] = field(default_factory=lambda: array("l"))
    _count: array[int] = field(default_factory=lambda: array("l"))  # beams, -1: not looked at
    _origin: array[float] = field(default_factory=lambda: array("f"))
    _ends: array[int] = field(default_factory=lambda: array("h"))

    def add(self, key: int, area: int, sight: Sight | None) -> None:
        """A scan of the path that belongs to an area; sight: None if it was not looked at."""
        self._key.append(key)
        self._area.append(area)
        if sight is None:
            self._count.append(-1)
            return
        self._count.append(len(sight.ends))
        self._origin.extend(sight.origin.tolist())
        ends = np.rint((sight.ends - sight.origin) / UNIT).astype(np.int16)
        self._ends.frombytes(ends.tobytes())

    def rewind(self, key: int) -> None:
        """Without the key scans from this one on."""
        while self._key and self._key[-1] >= key:
            self._key.pop()
            self._area.pop()
            beams = self._count.pop()
            if beams >= 0:
                del self._origin[-2:]
                del self._ends[len(self._ends) - 2 * beams :]

    def taken(self) -> Looks:
        """All of them."""
        count = np.array(self._count, dtype=np.int64)
        look = np.flatnonzero(count >= 0)
        origin = np.array(self._origin, dtype=float).reshape(-1, 2)
        ends = UNIT * np.array(self._ends, dtype=float).reshape(-1, 2)
        return Looks(
            key=np.array(self._key, dtype=np.int64),
            area=np.array(self._area, dtype=np.int64),
            look=look,
            origin=origin,
            ends=ends + np.repeat(origin, count[look], axis=0),
            first=np.concatenate(([0], np.cumsum(count[look]))),
        )
