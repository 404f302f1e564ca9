"""How two maps lie to each other, by a search over the whole plane and all headings.

Coarse first (`coarse_search`). The best places that it finds, each other than all before it, are
brought to where their walls fit best (Gauss-Newton on the distance field, walls farther than half
a metre counting little) and scored by points spread over the model; the best of these are brought
to the walls themselves and scored by all there is.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.evaluation.coarse_search import differ, starts
from hiermap_cli.evaluation.evidence import FREE_SPACING, HEADINGS, SPACING
from hiermap_cli.geometry.se2 import rotation, wrap

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hiermap_cli.evaluation.evidence import ModelPoints, Raster

    Array = NDArray[np.float64]
    Finder = Callable[[Array], tuple[NDArray[np.int64], Array]]

NEAR = 0.2  # metres within which a wall is where the reference has one
_SIGMA, _ANYWHERE = 0.15, 0.1  # metres of a wall beside its place; share of walls without one
_PLAIN = 3.0  # metres from all walls, from where nothing is drawn to one
_MIDST = 0.3  # metres from every wall
_NOT_FREE = 0.2  # likelihood of free ground that is not free in the reference, over that which is
_MOST = 1000  # points of walls that refine a pose
_MOST_SCORED = 5000  # points of walls that tell which places are the best
_FINALISTS, _ALWAYS = 12, 4  # places that are brought to the walls themselves, at most and always
_HOPELESS = 3.0  # the surprise of places that are not, over the least
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
    along_y, along_x = np.gradient(np.minimum(raster.distance, _PLAIN), raster.cell)
    slopes = np.asarray(along_y), np.asarray(along_x)
    rough = [_refined(about, raster, slopes, start) for start in starts(about, raster)]
    few = _thinned(about)
    likely = _likely(_distinct([Candidate(pose, *fit(few, raster, pose)) for pose in rough]))
    faces = _faces(raster)
    refined = [_on_lines(about, raster, faces, one.R_t_g) for one in likely]
    kept = _distinct([Candidate(pose, *fit(about, raster, pose)) for pose in refined])
    # Back from the model's centre to its frame.
    return [c._replace(R_t_g=_about(c.R_t_g, -centre)) for c in kept]


def _thinned(model: ModelPoints) -> ModelPoints:
    """One point of so many, by which places keep their order."""
    step = max(1, len(model.walls) // _MOST_SCORED)
    return model._replace(**{name: points[::step] for name, points in model._asdict().items()})


def _likely(found: list[Candidate]) -> list[Candidate]:
    """Those of places, best first, that may yet turn out to be one of the two best."""
    limit = _HOPELESS * found[0].surprise if found else 0.0
    return [c for i, c in enumerate(found[:_FINALISTS]) if i < _ALWAYS or c.surprise <= limit]


def _distinct(found: list[Candidate]) -> list[Candidate]:
    """Best first, without those that lie near a better one."""
    kept: list[Candidate] = []
    for one in sorted(found, key=lambda c: c.surprise):
        if all(differ(one.R_t_g, other.R_t_g) for other in kept):
            kept.append(one)
    return kept


def _about(pose: Array, shift: Array) -> Array:
    return np.array([*(pose[:2] + rotation(pose[2]) @ shift), pose[2]])


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


def _refined(
    model: ModelPoints,
    raster: Raster,
    slopes: tuple[Array, Array],
    start: Array,
    rounds: int = 12,
) -> Array:
    """The pose near `start` at which the walls lie nearest to the reference's.

    Weights fall with the distance (Geman and McClure), from a wide reach to a narrow one. `slopes`
    are those of the raster's distance, along y and along x.
    """
    pose = start.copy()
    walls = model.walls[:: max(1, len(model.walls) // _MOST)]
    slope_y, slope_x = slopes
    for i in range(rounds):
        reach = max(_ROBUST, 0.6 * 0.8**i)
        turned = walls @ rotation(pose[2]).T
        at, exists = _cells(raster, turned + pose[:2])
        d = np.minimum(raster.distance[at[:, 1], at[:, 0]], _PLAIN)
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


def _on_lines(model: ModelPoints, raster: Raster, faces: Finder, start: Array) -> Array:
    """The pose brought on from the cells of a raster to the walls themselves.

    Point to line: every point of the model is drawn across the wall that lies nearest, if that
    goes its way. What two walls a few centimetres from each other could each explain pulls little.
    """
    thin = slice(None, None, max(1, len(model.walls) // _MOST))
    walls, headings = model.walls[thin], model.headings[thin]
    pose = start.copy()
    for _ in range(8):
        turned = walls @ rotation(pose[2]).T
        at, apart = faces(turned + pose[:2])
        across = np.sin(headings + pose[2] - raster.headings[at])
        found = np.flatnonzero((apart < 2.0 * NEAR) & (np.abs(across) < _SAME_WAY))
        if len(found) < 3:
            break
        at, p = at[found], turned[found]
        n = np.column_stack((-np.sin(raster.headings[at]), np.cos(raster.headings[at])))
        error = ((p + pose[:2] - raster.faces[at]) * n).sum(axis=1)
        weight = 1.0 / (1.0 + (error / _CLOSE) ** 2) ** 2
        J = np.column_stack((n, p[:, 0] * n[:, 1] - p[:, 1] * n[:, 0]))
        A = (J * weight[:, None]).T @ J + np.diag([1e-3, 1e-3, 1e-1])
        step = -np.linalg.solve(A, J.T @ (weight * error))
        pose = pose + step
        if np.abs(step).max() < 1e-5:
            break
    pose[2] = wrap(pose[2])
    return pose


def _faces(raster: Raster) -> Finder:
    """What finds the index (n,) of the face that lies nearest to points (n, 2) and metres to it.

    The metres are infinite where none is near, whatever the index. By the raster where that knows
    them; by a tree, which takes longer to load and to ask, where it does not.
    """
    if raster.nearest is not None:
        return partial(_by_cells, raster, raster.nearest)
    from scipy.spatial import KDTree

    tree = KDTree(raster.faces)

    def by_tree(points: Array) -> tuple[NDArray[np.int64], Array]:
        metres, at = tree.query(points, distance_upper_bound=2.0 * NEAR)
        return np.where(np.isfinite(metres), at, 0), np.asarray(metres)

    return by_tree


def _by_cells(
    raster: Raster, nearest: NDArray[np.int64], points: Array
) -> tuple[NDArray[np.int64], Array]:
    """The nearest face of those that are nearest to a point's cell and to the cells about it."""
    at, exists = _cells(raster, points)
    height, width = nearest.shape
    best, least = np.zeros(len(points), np.int64), np.full(len(points), math.inf)
    for up in (-1, 0, 1):
        for aside in (-1, 0, 1):
            row = np.minimum(np.maximum(at[:, 1] + up, 0), height - 1)
            column = np.minimum(np.maximum(at[:, 0] + aside, 0), width - 1)
            face = nearest[row, column]
            apart = points - raster.faces[face]
            metres = np.where(exists & (face >= 0), np.sqrt((apart**2).sum(axis=1)), math.inf)
            nearer = metres < least
            best[nearer], least[nearer] = face[nearer], metres[nearer]
    return best, least
