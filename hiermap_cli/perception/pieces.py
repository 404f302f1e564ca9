"""Pieces of walls, the straight runs of a scan, as they are and while they are merged."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.perception.fitting import fit_moments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig
    from hiermap_cli.perception.beams import Beams

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]


class Pieces(NamedTuple):
    """Segments as merged runs: K segments in the order of their first points.

    sums: (6, K) moments. first, last: (K,) extreme points; of a wall across the seam of a full
    circle the first point comes after the last. run_first, run_last: (R,) the points of the runs
    that make up the segments, run_segment: (R,) whose they are; runs in order of their points.
    """

    sums: Array
    first: Index
    last: Index
    run_first: Index
    run_last: Index
    run_segment: Index


class Faces(NamedTuple):
    """What tells at a glance whether two segments may be one: all (K,).

    x0, y0, x1, y1: extreme points. extent: their squared distance. nx, ny: normal.
    """

    x0: Array
    y0: Array
    x1: Array
    y1: Array
    extent: Array
    nx: Array
    ny: Array

    def part(self, which: slice | Index) -> Faces:
        """Those of the segments `which`."""
        return Faces(*(v[which] for v in self))


class Merging:
    """The segments while they are merged: arrays over all of them, changed in place.

    scan: of each segment. scatter, noise: of its fit, and of a point across it. into: the segment
    it was merged into, itself if none. Moments are kept by rows, (K, 6).
    """

    def __init__(self, beams: Beams, pieces: Pieces, laser: LaserConfig, uneven: float) -> None:
        self.beams, self.laser, self.uneven = beams, laser, uneven
        count = len(pieces.first)
        self.sums = np.ascontiguousarray(pieces.sums.T)
        self.first, self.last = pieces.first, pieces.last.copy()
        self.scan = beams.cell[pieces.first] // beams.ranges.shape[1]
        self.into = np.arange(count)
        self.scatter, self.noise = np.empty(count), np.empty(count)
        ends = (v.take(end) for end in (self.first, self.last) for v in (beams.x, beams.y))
        self.faces = Faces(*ends, *(np.empty(count) for _ in range(3)))
        self.update(self.into)

    def update(self, k: Index) -> None:
        """Fit the segments k, and judge the noise of their points across the line.

        The noise is the larger of what the sensor has at that incidence and what the points show,
        as far as a wall may be uneven.
        """
        sums, last = self.sums.take(k, axis=0).T, self.last.take(k)
        line, scatter = fit_moments(sums)
        beams, laser = self.beams, self.laser
        faces, r = self.faces, beams.r.take(last)
        x, y = faces.x1.take(k), faces.y1.take(k)
        sigma = laser.sigma_range + laser.sigma_range_scale * r
        cosine = (line.nx * x + line.ny * y) / r
        shown = np.minimum(scatter / np.maximum(sums[0] - 2.0, 1.0), self.uneven)
        self.noise[k] = np.maximum((sigma * cosine) ** 2, shown)
        self.scatter[k] = scatter
        faces.nx[k], faces.ny[k] = line.nx, line.ny
        x -= faces.x0.take(k)
        y -= faces.y0.take(k)
        faces.extent[k] = x * x + y * y

    def join(self, i: Index, j: Index) -> None:
        """Merge each segment j into i; no segment may occur twice."""
        self.sums[i] += self.sums[j]
        for end in (self.last, self.faces.x1, self.faces.y1):
            end[i] = end[j]
        self.into[j] = i
        self.update(i)

    def alive(self, least: int) -> Index:
        """The segments that are not merged into others and have at least so many points."""
        whole = self.into == np.arange(len(self.into))
        return np.flatnonzero(whole & (self.sums[:, 0] >= least))
