"""How two maps lie to each other, by a search over the whole plane and all headings.

Coarse first: for every heading at which the directions of both maps' walls agree, all shifts at
once, as a correlation by the fast Fourier transform of the model's walls with a blurred raster of
the reference's and of its free ground with what the reference calls free. Then the best of them,
each other than all before it, are brought to where their walls fit best (Gauss-Newton on the
distance field, walls farther than half a metre counting little) and scored finely.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.evaluation.evidence import BINS, FREE_SPACING, HEADINGS, SPACING, directions
from hiermap_cli.geometry.se2 import rotation, wrap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.evaluation.evidence import ModelPoints, Raster

    Array = NDArray[np.float64]

NEAR = 0.2  # metres within which a wall is where the reference has one
_COARSE = 0.4  # metres a cell of the first search
_BLUR = 0.4  # metres, of walls in the first search
_TRIED = 40  # places of the first search that are looked at closely
APART, TURNED = 1.0, math.radians(10.0)  # two alignments that differ by less are one
_SIGMA, _ANYWHERE = 0.15, 0.1  # metres of a wall beside its place; share of walls without one
_MIDST = 0.3  # metres from every wall
_NOT_FREE = 0.2  # likelihood of free ground that is not free in the reference, over that which is
_MOST = 2000  # points that refine a pose
_FINALISTS = 12  # places that are brought to the walls themselves
_SAME_WAY = math.sin(math.radians(30.0))  # of a wall that is drawn to another
_CLOSE = 0.1  # metres at which a wall's pull to a line is a quarter
_ROBUST = 0.15  # metres at which a wall's pull is halved


class Candidate(NamedTuple):
    """A place of the model's frame in the reference's, R_t_g (3,), and how well it fits.

    surprise: what of the model the reference does not explain, in nats; see `fit`. walls: share of
    the model's wall length within 0.2 m of a wall of the reference. ground: share of its free
    ground that is free there; 1 where the reference does not say what is free. against: share of
    the walls that stand in the midst of ground known to be bare.
    """

    R_t_g: Array
    surprise: float
    walls: float
    ground: float
    against: float


def search(model: ModelPoints, raster: Raster) -> list[Candidate]:
    """The alignments found, best first, each more than 1 m or 10 degrees from all before it."""
    centre = np.concatenate((model.walls, model.free)).mean(axis=0)
    about = model._replace(walls=model.walls - centre, free=model.free - centre)
    rough = [_refined(about, raster, start) for start in _starts(about, raster)]
    likely = _distinct([Candidate(pose, *fit(about, raster, pose)) for pose in rough])[:_FINALISTS]
    refined = _on_lines(about, raster, [one.R_t_g for one in likely])
    kept = _distinct([Candidate(pose, *fit(about, raster, pose)) for pose in refined])
    # Back from the model's centre to its frame.
    return [c._replace(R_t_g=_about(c.R_t_g, -centre)) for c in kept]


def _distinct(found: list[Candidate]) -> list[Candidate]:
    """Best first, without those that lie near a better one."""
    kept: list[Candidate] = []
    for one in sorted(found, key=lambda c: c.surprise):
        if all(_differ(one.R_t_g, other.R_t_g) for other in kept):
            kept.append(one)
    return kept


def _about(pose: Array, shift: Array) -> Array:
    return np.array([*(pose[:2] + rotation(pose[2]) @ shift), pose[2]])


def _differ(a: Array, b: Array) -> bool:
    return bool(math.hypot(a[0] - b[0], a[1] - b[1]) > APART or abs(wrap(a[2] - b[2])) > TURNED)


def fit(model: ModelPoints, raster: Raster, pose: Array) -> tuple[float, float, float, float]:
    """All but the pose of a candidate, for a model about its own origin at `pose`.

    The surprise is the negative logarithm of a likelihood: of every half metre of wall the
    mixture of a Gaussian about the nearest wall of about the same direction with a share of walls
    that are anywhere, less likely still in the midst of ground known to be bare; of every half
    square metre of free ground a share that is not free. Walls count by the inverse root of how
    many go their way, so that the few that lie across a corridor are not drowned by its sides.
    """
    at, exists = _cells(raster, model.walls @ rotation(pose[2]).T + pose[:2])
    turned = np.remainder(model.headings + pose[2], math.pi) / math.pi
    way = np.round(turned * HEADINGS).astype(int) % HEADINGS
    facing = np.where(exists, raster.facing[way, at[:, 1], at[:, 0]], math.inf)
    near = np.where(exists, raster.distance[at[:, 1], at[:, 0]], math.inf)
    nats = -np.log((1.0 - _ANYWHERE) * np.exp(-0.5 * (facing / _SIGMA) ** 2) + _ANYWHERE)
    ground, against, total = 1.0, 0.0, 0.0
    if raster.free is not None:
        if raster.bare:
            bare = exists & raster.free[at[:, 1], at[:, 0]] & (near > _MIDST)
            nats += bare
            against = float(bare.mean())
        if len(model.free):
            at, exists = _cells(raster, model.free @ rotation(pose[2]).T + pose[:2])
            free = raster.free[at[:, 1], at[:, 0]] & exists
            ground = float(free.mean())
            total -= math.log(_NOT_FREE) * float((~free).sum()) * FREE_SPACING**2 / 0.5
    total += float((model.weights * nats).sum()) * SPACING / 0.5
    return total, float((near <= NEAR).mean()), ground, against


def _cells(raster: Raster, points: Array) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    at = np.floor((points - raster.low) / raster.cell).astype(np.int64)
    height, width = raster.distance.shape
    exists = np.asarray(((at >= 0) & (at < (width, height))).all(axis=1))
    at[~exists] = 0
    return at, exists


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


def _starts(model: ModelPoints, raster: Raster) -> list[Array]:
    """Poses (3,) of the coarse search, best first."""
    factor = max(1, round(_COARSE / raster.cell))
    cell = factor * raster.cell
    walls = _pooled(np.exp(-0.5 * (raster.distance / _BLUR) ** 2), factor)
    layers = [(walls, model.walls)]
    if raster.free is not None and len(model.free):
        layers.append((_pooled(raster.free.astype(float), factor), model.free))
    reach = np.hypot(*np.concatenate((model.walls, model.free)).T).max()
    pad = math.ceil(reach / cell) + 1
    size = [_fast(n + 2 * pad + 1) for n in walls.shape]
    spectra = [np.fft.rfft2(layer, size) for layer, _ in layers]
    best: list[tuple[float, Array]] = []
    for heading in _headings(model, raster, max(cell / reach, math.radians(0.5))).tolist():
        turn = rotation(heading)
        total = np.ones(())
        for spectrum, (_, points) in zip(spectra, layers, strict=True):
            column, row = np.floor(points @ turn.T / cell).astype(int).T
            mask = np.bincount(
                (row % size[0]) * size[1] + column % size[1], None, size[0] * size[1]
            )
            product = spectrum * np.conj(np.fft.rfft2(mask.reshape(size) / len(points)))
            total = total * np.maximum(np.fft.irfft2(product, size), 0.0)
        for row, column, score in _peaks(total, 8):
            at = np.array([column, row]) - np.where(
                np.array([column, row]) > np.array(size[::-1]) - pad, size[::-1], 0
            )
            best.append((score, np.array([*(raster.low + (at + 0.5) * cell), heading])))
    best.sort(key=lambda item: -item[0])
    kept: list[Array] = []
    for _, pose in best:
        if all(_differ(pose, other) for other in kept):
            kept.append(pose)
        if len(kept) == _TRIED:
            break
    return kept


def _peaks(values: Array, count: int) -> list[tuple[int, int, float]]:
    """Rows, columns and values of the largest cells that are the largest of their neighbours."""
    around = values.copy()
    for axis in (0, 1):
        around = np.maximum(around, np.maximum(np.roll(around, 1, axis), np.roll(around, -1, axis)))
    at = np.flatnonzero(values.ravel() >= around.ravel())
    chosen = at[np.argsort(-values.ravel()[at], kind="stable")[:count]]
    rows, columns = np.divmod(chosen, values.shape[1])
    picked = zip(rows.tolist(), columns.tolist(), values.ravel()[chosen].tolist(), strict=True)
    return list(picked)


def _pooled(values: Array, factor: int) -> Array:
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


def _refined(model: ModelPoints, raster: Raster, start: Array, rounds: int = 25) -> Array:
    """The pose near `start` at which the walls lie nearest to the reference's.

    Weights fall with the distance (Geman and McClure), from a wide reach to a narrow one.
    """
    pose = start.copy()
    walls = model.walls[:: max(1, len(model.walls) // _MOST)]
    slope_y, slope_x = np.gradient(np.minimum(raster.distance, 3.0), raster.cell)
    for i in range(rounds):
        reach = max(_ROBUST, 0.6 * 0.8**i)
        turned = walls @ rotation(pose[2]).T
        at, exists = _cells(raster, turned + pose[:2])
        d = raster.distance[at[:, 1], at[:, 0]]
        gx, gy = slope_x[at[:, 1], at[:, 0]], slope_y[at[:, 1], at[:, 0]]
        weight = exists / (1.0 + (d / reach) ** 2) ** 2
        J = np.column_stack((gx, gy, turned[:, 0] * gy - turned[:, 1] * gx))
        A = (J * weight[:, None]).T @ J + np.diag([1e-3, 1e-3, 1e-1])
        step = -np.linalg.solve(A, J.T @ (weight * d))
        step *= min(1.0, 0.5 / max(1e-9, float(np.hypot(step[0], step[1]))))
        pose = pose + step
        if np.abs(step).max() < 1e-4 and reach == _ROBUST:
            break
    pose[2] = wrap(pose[2])
    return pose


def _on_lines(model: ModelPoints, raster: Raster, starts: list[Array]) -> list[Array]:
    """The poses brought on from the cells of a raster to the walls themselves.

    Point to line: every point of the model is drawn across the wall that lies nearest, if that
    goes its way. What two walls a few centimetres from each other could each explain pulls little.
    """
    from scipy.spatial import KDTree

    tree = KDTree(raster.faces)
    normals = np.column_stack((-np.sin(raster.headings), np.cos(raster.headings)))
    thin = slice(None, None, max(1, len(model.walls) // _MOST))
    walls, headings = model.walls[thin], model.headings[thin]
    out = []
    for start in starts:
        pose = start.copy()
        for _ in range(8):
            turned = walls @ rotation(pose[2]).T
            query = tree.query(turned + pose[:2], distance_upper_bound=2.0 * NEAR)
            apart, nearest = np.asarray(query[0]), np.asarray(query[1])
            found = np.flatnonzero(np.isfinite(apart))
            at = nearest[found]
            across = np.sin(headings[found] + pose[2] - raster.headings[at])
            found, at = found[np.abs(across) < _SAME_WAY], at[np.abs(across) < _SAME_WAY]
            if len(found) < 3:
                break
            n, p = normals[at], turned[found]
            error = ((p + pose[:2] - raster.faces[at]) * n).sum(axis=1)
            weight = 1.0 / (1.0 + (error / _CLOSE) ** 2) ** 2
            J = np.column_stack((n, p[:, 0] * n[:, 1] - p[:, 1] * n[:, 0]))
            A = (J * weight[:, None]).T @ J + np.diag([1e-3, 1e-3, 1e-1])
            step = -np.linalg.solve(A, J.T @ (weight * error))
            pose = pose + step
            if np.abs(step).max() < 1e-5:
                break
        pose[2] = wrap(pose[2])
        out.append(pose)
    return out
