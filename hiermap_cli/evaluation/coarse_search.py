"""Where on a reference a model may lie: all shifts at every heading that its walls allow.

For one heading all shifts are scored at once, as correlations by the fast Fourier transform of the
model's walls with a blurred raster of the reference's, and of its free ground with what the
reference calls free.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.evaluation.evidence import BINS, directions
from hiermap_cli.geometry.se2 import rotation, wrap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.evaluation.evidence import ModelPoints, Raster

    Array = NDArray[np.float64]

APART, TURNED = 1.0, math.radians(10.0)  # two alignments that differ by less are one
_CELL, _CELLS = (
    0.4,
    100,
)  # metres of a cell; of a larger model the cells are a hundredth of its reach
_BLUR = 0.4  # metres, of walls
_TRIED = 40  # places that are looked at closely
_BEYOND = 0.5  # of the model's reach, that its middle may lie outside the reference
_PEAKS = 8  # of them at one heading
_MOST = 5_000  # points of a layer


def differ(a: Array, b: Array) -> bool:
    """Whether two alignments (3,) are not one."""
    return bool(math.hypot(a[0] - b[0], a[1] - b[1]) > APART or abs(wrap(a[2] - b[2])) > TURNED)


def starts(model: ModelPoints, raster: Raster) -> list[Array]:
    """Poses (3,) of a model about its own middle at which the maps go together, best first."""
    reach = float(np.hypot(*np.concatenate((model.walls, model.free)).T).max())
    factor = max(1, round(max(_CELL, reach / _CELLS) / raster.cell))
    cell = factor * raster.cell
    layers = [(_pooled(np.exp(-0.5 * (raster.distance / _BLUR) ** 2), factor), model.walls)]
    if raster.free is not None and len(model.free):
        layers.append((_pooled(raster.free, factor), model.free))
    pad = math.ceil(reach / cell) + 1
    # The model's middle may lie `beyond` outside the raster; what wraps around falls on no wall.
    beyond = math.ceil(_BEYOND * pad)
    size = [_fast(n + pad + beyond) for n in layers[0][0].shape]
    asked = [np.arange(-beyond, n + beyond) for n in layers[0][0].shape]
    spectra = [(np.fft.rfft2(layer, size), _thinned(points)) for layer, points in layers]
    best: list[tuple[float, Array]] = []
    for heading in _headings(model, raster, max(cell / reach, math.radians(0.5))).tolist():
        turn = rotation(heading) / cell
        total = np.ones(())
        for spectrum, points in spectra:
            share = np.fft.rfft2(_mirrored(points @ turn.T, size))
            share *= spectrum
            total = total * np.maximum(np.fft.irfft2(share, size), 0.0)
        total = total.take(asked[0], axis=0, mode="wrap").take(asked[1], axis=1, mode="wrap")
        for row, column, score in _peaks(total):
            at = np.array([column, row]) - beyond + 0.5
            best.append((score, np.array([*(raster.low + at * cell), heading])))
    best.sort(key=lambda item: -item[0])
    kept: list[Array] = []
    for _, pose in best:
        if all(differ(pose, other) for other in kept):
            kept.append(pose)
        if len(kept) == _TRIED:
            break
    return kept


def _thinned(points: Array) -> Array:
    return points[:: max(1, len(points) // _MOST)]


def _mirrored(points: Array, size: list[int]) -> Array:
    """The share of points (n, 2), in cells, of each cell, turned about the first by half a turn.

    A product of its spectrum is a correlation.
    """
    column, row = -np.floor(points).astype(np.int64).T
    at = (row % size[0]) * size[1] + column % size[1]
    return np.bincount(at, minlength=size[0] * size[1]).reshape(size) / len(points)


def _headings(model: ModelPoints, raster: Raster, step: float) -> Array:
    """Headings (k,) all around, at which the directions of both maps' walls go together.

    Those whose correlation of directions lies in the upper half of its range; all of them where
    directions tell nothing.
    """
    theirs, own = directions(raster.headings, 2.0), directions(model.headings, 2.0)
    spectrum = np.fft.rfft(theirs) * np.conj(np.fft.rfft(own))
    agreement = np.fft.irfft(spectrum, BINS)
    headings = np.arange(0.0, 2.0 * math.pi, step)
    here = agreement[np.round(headings / math.pi * BINS).astype(int) % BINS]
    chosen: Array = headings[here >= 0.5 * (agreement.min() + agreement.max())]
    return chosen


def _peaks(values: Array) -> list[tuple[int, int, float]]:
    """Rows, columns and values of the largest cells that are the largest of their neighbours."""
    around = values
    for axis in (0, 1):
        around = np.maximum(around, np.maximum(np.roll(around, 1, axis), np.roll(around, -1, axis)))
    at = np.flatnonzero((values == around) & (values > 0.0))
    chosen = at[np.argsort(-values.ravel()[at], kind="stable")[:_PEAKS]]
    rows, columns = np.divmod(chosen, values.shape[1])
    picked = zip(rows.tolist(), columns.tolist(), values.ravel()[chosen].tolist(), strict=True)
    return list(picked)


def _pooled(values: NDArray[np.float64] | NDArray[np.bool_], factor: int) -> Array:
    """Means over blocks of `factor` cells each way."""
    height, width = (-(-n // factor) * factor for n in values.shape)
    padded = np.zeros((height, width))
    padded[: values.shape[0], : values.shape[1]] = values
    blocks = padded.reshape(height // factor, factor, width // factor, factor)
    return np.asarray(blocks.mean(axis=(1, 3)))


def _fast(n: int) -> int:
    """The least number not below n that has no prime factors but 2, 3 and 5."""
    while True:
        rest = n
        for prime in (2, 3, 5):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return n
        n += 1
