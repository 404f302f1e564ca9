"""Points told scan after scan, of which those of the last scans are asked for together."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

ROOM = 4096  # points that there is room for at first
FAR = 1e6  # metres: a point there is near nothing


class NearEnds:
    """The points of successive scans, in columns one after the other.

    Those of all scans since one are a view, where a list of arrays would have to be joined.
    """

    def __init__(self) -> None:
        self._xy = np.empty((2, ROOM))
        self._starts: list[int] = []
        self._stop = 0
        self._shed = 0  # points that once lay before the first one

    def __len__(self) -> int:
        """The number of scans."""
        return len(self._starts)

    def append(self, points: Array) -> None:
        """The points (n, 2) of the next scan."""
        n = len(points)
        if self._stop + n > self._xy.shape[1]:
            kept = self.since(0).T
            first = self._stop - kept.shape[1]
            self._xy = np.empty((2, max(ROOM, 2 * (kept.shape[1] + n))))
            self._xy[:, : kept.shape[1]] = kept
            self._starts = [start - first for start in self._starts]
            self._stop -= first
            self._shed += first
        self._starts.append(self._stop)
        self._xy[:, self._stop : self._stop + n] = points.T
        self._stop += n

    def __delitem__(self, scans: slice) -> None:
        """Without the first scans, `[:k]`, or the last ones, `[k:]`."""
        first, stop, _ = scans.indices(len(self._starts))
        if first < stop == len(self._starts):
            self._stop = self._starts[first]
        del self._starts[scans]

    def position(self) -> int:
        """Where the points of the next scan will lie, for `blank`."""
        return self._shed + self._stop

    def blank(self, position: int, gone: NDArray[np.bool_]) -> None:
        """Those points of a scan at this position that are `gone` (n,) are near nothing."""
        first = position - self._shed
        if first >= 0:
            self._xy[:, first : first + len(gone)][:, gone] = FAR

    def since(self, scan: int) -> Array:
        """The points (n, 2) of this scan and all later ones."""
        first = self._starts[scan] if scan < len(self._starts) else self._stop
        return self._xy[:, first : self._stop].T

    def of(self, scan: int) -> Array:
        """The points (n, 2) of one scan."""
        stop = self._starts[scan + 1] if scan + 1 < len(self._starts) else self._stop
        return self._xy[:, self._starts[scan] : stop].T

    def move(self, R_b_a: Array) -> None:
        """Into another frame, from which the present one is seen as `R_b_a` (3,)."""
        (x, y), (x_b, y_b, theta) = self.since(0).T, R_b_a.tolist()
        c, s = math.cos(theta), math.sin(theta)
        self._xy[:, self._stop - len(x) : self._stop] = x_b + c * x - s * y, y_b + s * x + c * y
