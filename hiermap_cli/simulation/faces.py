"""The boundary of a free space that is given as overlapping polygons.

Every edge of every polygon is cut wherever another edge meets it; a piece is a face where one
side of it is free and the other is not. Pieces of one line that follow each other are joined.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.simulation.polygons import contains, crossings, edges, within

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

_PROBE = 1e-5  # metres from a piece to the points that tell its sides apart
_SHORTEST = 1e-6  # metres; what is shorter is rounding
_DECIMALS = 9  # of the coordinates that come out


def boundary(
    *,
    insides: Sequence[Array],
    openings: Sequence[Array],
    buildings: Sequence[Array],
    solids: Sequence[Array],
) -> Array:
    """Faces (n, 4) of the free space, the free side on their left.

    Free is what lies in one of `insides` or `openings`, or, where `buildings` are given, in none
    of them; and in any case in none of `solids`. All are polygons of shape (k, 2).
    """
    polygons = [*insides, *openings, *buildings, *solids]
    pieces = _cut([edges(corners) for corners in polygons])
    middle = 0.5 * (pieces[:, :2] + pieces[:, 2:])
    along = pieces[:, 2:] - pieces[:, :2]
    length = np.hypot(along[:, 0], along[:, 1])
    normal = np.column_stack((-along[:, 1], along[:, 0])) / length[:, None]
    probes = np.vstack((middle + _PROBE * normal, middle - _PROBE * normal))
    free = _any_contains([*insides, *openings], probes)
    if buildings:
        free |= ~_any_contains(buildings, probes)
    free &= ~_any_contains(solids, probes)
    left, right = free[: len(pieces)], free[len(pieces) :]
    faces = np.vstack((pieces[left & ~right], pieces[right & ~left][:, [2, 3, 0, 1]]))
    return _joined(np.round(faces, _DECIMALS))


def _any_contains(polygons: Sequence[Array], points: Array) -> NDArray[np.bool_]:
    found = np.zeros(len(points), dtype=bool)
    for corners in polygons:
        found |= contains(corners, points)
    return found


def _cut(groups: Sequence[Array]) -> Array:
    """All segments of all groups (each (k, 4)), cut where those of another group meet them."""
    segments = np.vstack(groups)
    owners = np.repeat(np.arange(len(groups)), [len(group) for group in groups])
    cuts: list[list[float]] = [[0.0, 1.0] for _ in segments]
    for owner, group in enumerate(groups):
        low = np.minimum(group[:, :2], group[:, 2:]).min(axis=0) - _SHORTEST
        high = np.maximum(group[:, :2], group[:, 2:]).max(axis=0) + _SHORTEST
        near = np.flatnonzero(within(segments, low, high) & (owners != owner))
        for index, fractions in zip(near, _meetings(segments[near], group), strict=True):
            cuts[index].extend(fractions[np.isfinite(fractions)].tolist())
    pieces = []
    for segment, fractions in zip(segments, cuts, strict=True):
        length = float(np.hypot(*(segment[2:] - segment[:2])))
        at = np.unique(np.clip(fractions, 0.0, 1.0))
        # A cut within rounding of the one before it is the same cut; the ends always stay.
        keep = np.concatenate(([True], np.diff(at) * length > _SHORTEST))
        at = at[keep]
        at[-1] = 1.0
        points = segment[:2] + at[:, None] * (segment[2:] - segment[:2])
        points[-1] = segment[2:]
        pieces.append(np.hstack((points[:-1], points[1:])))
    return np.vstack(pieces)


def _meetings(segments: Array, others: Array) -> Array:
    """Fractions along each of (s, 4) at which `others` (o, 4) meet it, or end on it; (s, 2o)."""
    along = segments[:, 2:] - segments[:, :2]
    length2 = np.sum(along * along, axis=1)[:, None]
    corners = others[None, :, :2] - segments[:, None, :2]  # every corner begins one edge
    t = np.einsum("soc,sc->so", corners, along) / length2
    off = corners - t[..., None] * along[:, None, :]
    on_it = (np.hypot(off[..., 0], off[..., 1]) < _SHORTEST) & (t >= 0.0) & (t <= 1.0)
    return np.hstack((crossings(segments, others), np.where(on_it, t, np.nan)))


def _joined(faces: Array) -> Array:
    """Doubled faces once, and those of one line that follow each other as one; sorted."""
    lengths = np.hypot(*(faces[:, 2:] - faces[:, :2]).T)
    faces = np.unique(faces[lengths > _SHORTEST], axis=0)
    starts: dict[tuple[int, int], list[int]] = {}
    ends: dict[tuple[int, int], list[int]] = {}
    for index, face in enumerate(faces):
        starts.setdefault(_key(face[:2]), []).append(index)
        ends.setdefault(_key(face[2:]), []).append(index)
    along = faces[:, 2:] - faces[:, :2]
    along /= np.hypot(along[:, 0], along[:, 1])[:, None]
    following: dict[int, int] = {}
    for point, incoming in ends.items():
        outgoing = starts.get(point, [])
        if len(incoming) == len(outgoing) == 1:
            i, j = incoming[0], outgoing[0]
            if i != j and float(np.dot(along[i], along[j])) > 0.5 and _parallel(along[i], along[j]):
                following[i] = j
    out = []
    for first in sorted(set(range(len(faces))) - set(following.values())):
        last = first
        while last in following:
            last = following[last]
        out.append([*faces[first, :2], *faces[last, 2:]])
    return np.array(out).reshape(-1, 4)


def _parallel(a: Array, b: Array) -> bool:
    return abs(float(a[0] * b[1] - a[1] * b[0])) < _SHORTEST


def _key(point: Array) -> tuple[int, int]:
    """A name for a point that survives rounding errors."""
    x, y = np.round(point / _SHORTEST).astype(np.int64).tolist()
    return x, y
