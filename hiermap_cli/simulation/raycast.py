"""Ray casting of whole scans at many poses at once, without a loop over beams or walls.

Every face that turns its free side to the laser covers an unbroken run of beams, from the bearing
of its first end to that of its second. Only these pairs of face and beam are computed, and the
nearest pair of each beam counts. On an office floor that is some three pairs a beam, however
large the building: faces out of reach are left out for a block of poses as a whole.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry.se2 import compose
from hiermap_cli.simulation.polygons import within

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.logs.records import LaserGeometry, Mount

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

CHUNK = 64  # poses cast at once: their pairs stay in the processor's cache
_EDGE_ON = 1e-7  # metres; a face seen more edge-on than this is not seen
_OVERLAP = 1e-9  # of a beam's width, so that no beam slips between two faces that meet


class _Runs(NamedTuple):
    """K runs of beams: scan, first beam, number of beams, and the entry they came from (K,)."""

    scan: Index
    first: Index
    length: Index
    source: Index


class RayCaster:
    """Casts scans of one laser among fixed faces and moving discs.

    Args:
        faces: (S, 4) segments in the world frame, the free side on their left; seen from the
            other side they are not there.
        laser: the beams; its `range_max` is the farthest return.
        mount: the true pose of the laser on the robot.
    """

    def __init__(self, faces: Array, laser: LaserGeometry, mount: Mount) -> None:
        self._laser = laser
        self._mount = mount.pose()
        # A flipped laser sees its beams run clockwise: they are cast the other way and turned.
        step = -laser.angle_increment if mount.flipped else laser.angle_increment
        first = -laser.angle_min if mount.flipped else laser.angle_min
        self._reversed = step < 0.0
        self._step = abs(step)
        self._first = first + step * (laser.beams - 1) if self._reversed else first
        along = faces[:, 2:] - faces[:, :2]
        length = np.hypot(along[:, 0], along[:, 1])
        self._faces = faces
        self._normal = np.column_stack((along[:, 1], -along[:, 0])) / length[:, None]
        self._normal_angle = np.arctan2(self._normal[:, 1], self._normal[:, 0])
        self._offset = np.sum(self._normal * faces[:, :2], axis=1)
        self._middle = 0.5 * (faces[:, :2] + faces[:, 2:])
        self._half = 0.5 * length

    def ranges(self, poses: Array, discs: Array | None = None, radius: float = 0.0) -> Array:
        """Ranges (B, beams) in metres, float64 and without noise; inf where nothing is in reach.

        Args:
            poses: (B, 3) the robot in the world frame.
            discs: (B, K, 2) middles of round things of `radius` metres at each scan's moment; one
                that holds the laser itself is not seen.
            radius: metres.
        """
        out = np.full((len(poses), self._laser.beams), np.inf)
        for start in range(0, len(poses), CHUNK):
            chunk = slice(start, start + CHUNK)
            origins = compose(poses[chunk], self._mount)
            nearest = out[chunk].reshape(-1)  # a view: the chunk is contiguous
            self._cast_faces(origins, nearest)
            if discs is not None and discs.shape[1]:
                self._cast_discs(origins, discs[chunk], radius, nearest)
        out[out > self._laser.range_max] = np.inf
        return out[:, ::-1] if self._reversed else out

    def _cast_faces(self, origins: Array, nearest: Array) -> None:
        reach = self._laser.range_max
        low, high = origins[:, :2].min(axis=0) - reach, origins[:, :2].max(axis=0) + reach
        near = np.flatnonzero(within(self._faces, low, high))
        if not len(near):
            return
        x, y = origins[:, 0, None], origins[:, 1, None]
        normal, middle = self._normal[near], self._middle[near]
        # Distance of each face's line from each laser, positive on the free side.
        height = self._offset[near] - x * normal[:, 0] - y * normal[:, 1]
        square = (middle[:, 0] - x) ** 2 + (middle[:, 1] - y) ** 2
        seen = (height > _EDGE_ON) & (height <= reach) & (square <= (reach + self._half[near]) ** 2)
        scan, face = np.nonzero(seen)
        height = height[scan, face]
        face = near[face]
        a = self._faces[face, :2] - origins[scan, :2]
        b = self._faces[face, 2:] - origins[scan, :2]
        # Seen from the free side, a face runs counterclockwise; the angle it fills is below pi.
        bearing = np.arctan2(a[:, 1], a[:, 0])
        filled = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], np.sum(a * b, axis=1))
        runs = self._runs(scan, bearing - origins[scan, 2], filled)
        source, flat, angle = self._pairs(runs)
        # r = height / cos(angle between the beam and the face's normal)
        aside = origins[scan, 2] - self._normal_angle[face]
        r = height[source] / np.maximum(np.cos(aside[source] + angle), 1e-12)
        np.minimum.at(nearest, flat, r)

    def _cast_discs(self, origins: Array, discs: Array, radius: float, nearest: Array) -> None:
        offset = discs - origins[:, None, :2]
        square = np.sum(offset * offset, axis=-1)
        seen = (square > radius**2) & (square < (self._laser.range_max + radius) ** 2)
        scan, disc = np.nonzero(seen)
        offset, square = offset[scan, disc], square[scan, disc]
        towards = np.arctan2(offset[:, 1], offset[:, 0]) - origins[scan, 2]
        half = np.arcsin(radius / np.sqrt(square))
        runs = self._runs(scan, towards - half, 2.0 * half)
        source, flat, angle = self._pairs(runs)
        distance = np.sqrt(square[source])
        aside = angle - towards[source]
        root = radius**2 - (distance * np.sin(aside)) ** 2
        r = distance * np.cos(aside) - np.sqrt(np.maximum(root, 0.0))
        np.minimum.at(nearest, flat, r)

    def _runs(self, scan: Index, bearing: Array, filled: Array) -> _Runs:
        """The beams within `filled` radians from `bearing` (relative to the laser's heading).

        A run that goes on past the full turn is split in two.
        """
        turn = 2.0 * np.pi / self._step
        first = np.mod(bearing - self._first, 2.0 * np.pi) / self._step
        last = first + filled / self._step
        source = np.arange(len(scan))
        again = np.flatnonzero(last >= turn - 1.0)
        first = np.concatenate((first, first[again] - turn))
        last = np.concatenate((last, last[again] - turn))
        source = np.concatenate((source, source[again]))
        begin = np.maximum(np.ceil(first - _OVERLAP), 0.0).astype(np.int64)
        end = np.minimum(np.floor(last + _OVERLAP), self._laser.beams - 1.0).astype(np.int64)
        kept = end >= begin
        source, begin, end = source[kept], begin[kept], end[kept]
        return _Runs(scan[source], begin, end - begin + 1, source)

    def _pairs(self, runs: _Runs) -> tuple[Index, Index, Array]:
        """Per pair of run and beam: the run's source, the beam's flat index and its angle."""
        shift = runs.first - (np.cumsum(runs.length) - runs.length)
        beam = np.arange(int(runs.length.sum())) + np.repeat(shift, runs.length)
        flat = beam + np.repeat(runs.scan * self._laser.beams, runs.length)
        return np.repeat(runs.source, runs.length), flat, self._first + self._step * beam
