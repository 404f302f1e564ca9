"""Landmarks found twice: seen from another area through a door, or in a place known twice.

A landmark belongs to one area. Where two areas show the same one, the one in whose free space it
stands keeps it, and of several the one to whose robot it was worth more. Within an area the same
holds of walls that the filter has twice.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.geometry import points, se2
from hiermap_cli.perception.kinds.rules import SegmentShape

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.config import LandmarkConfig
    from hiermap_cli.mapping.areas.landmarks import Draft

    Array = NDArray[np.float64]

_FARTHEST = 0.4  # metres between two sightings of one point, however uncertain their areas are
_ALIKE = 0.7  # cosine between the sides on which two landmarks have their material
_BEFORE = 0.3  # metres before a segment's middle, where its area's free space is
_COVERED = 0.7  # of a wall's length that another landmark has, to be the same


class Placed(NamedTuple):
    """A landmark in g.

    area: the area that has it. pose: (3,). sigma: deviation of its position. material: (2,) unit
    vector towards where most of its material is, zero where it has as much on all sides.
    segments: (k, 2, 2). utility: what decides between two. inside: whether it lies in its area.
    fixed: it may not be dropped.
    """

    area: int
    kind: str
    binds: tuple[str, ...]
    pose: Array
    sigma: float
    material: Array
    segments: Array
    utility: float
    inside: bool
    fixed: bool


def place_draft(
    area: int,
    draft: Draft,
    frame: Array,
    C_frame: Array,
    C_draft: Array,
    extent: Array,
    *,
    fixed: bool,
) -> Placed:
    """A landmark in g. frame: (3,) R_g_a; covariances (3, 3) additive; extent: (m, 2) in a."""
    pose = se2.compose(frame, draft.pose)
    J1 = se2.compose_D_first(frame, draft.pose)[:2]
    J2 = se2.compose_D_second(frame, draft.pose)[:2]
    C = J1 @ C_frame @ J1.T + J2 @ C_draft @ J2.T
    ends = np.array([s.ends for s in draft.shape if isinstance(s, SegmentShape)]).reshape(-1, 2, 2)
    here = points.h(draft.pose, ends)
    run = here[:, 1] - here[:, 0]
    length = np.hypot(run[:, 0], run[:, 1])
    right = np.column_stack((run[:, 1], -run[:, 0])) / np.maximum(length, 1e-9)[:, None]
    if len(right):
        before = here.mean(axis=1) - _BEFORE * right
    else:
        right = se2.rotation(draft.pose[2])[:, 1][None]
        before = draft.pose[:2] - _BEFORE * right
    material = right.sum(axis=0)
    size = float(np.hypot(*material))
    material = material / size if size > 0.5 else np.zeros(2)
    return Placed(
        area=area,
        kind=draft.kind,
        binds=draft.binds,
        pose=pose,
        sigma=float(np.sqrt(np.linalg.eigvalsh(C)[-1])),
        material=se2.rotation(frame[2]) @ material,
        segments=points.h(frame, here),
        utility=draft.utility,
        inside=bool(2 * contains(extent, before).sum() >= len(before)),
        fixed=fixed,
    )


def contains(polygon: Array, at: Array) -> NDArray[np.bool_]:
    """Which points (n, 2) lie in a polygon (m, 2)."""
    if len(polygon) < 3:
        return np.zeros(len(at), dtype=bool)
    (x1, y1), (x2, y2) = polygon.T[:, :, None], np.roll(polygon, -1, axis=0).T[:, :, None]
    x, y = at.T
    spans = (y1 > y) != (y2 > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = x1 + (y - y1) * (x2 - x1) / (y2 - y1)
    inside: NDArray[np.bool_] = (spans & (x < crossing)).sum(axis=0) % 2 == 1
    return inside


def duplicates(landmarks: Sequence[Placed], config: LandmarkConfig) -> set[int]:
    """Indices of the landmarks that are there once more, and better."""
    order = sorted(range(len(landmarks)), key=lambda i: (_place(landmarks[i]), i))
    near = _Near(landmarks, config.same)
    dropped: set[int] = set()
    for i in order:
        one = landmarks[i]
        same = _again(one, near.points(i), config) if "x" in one.binds else False
        if not same and one.kind in ("wall", "corridor"):
            others = [o for o in near.touching(i) if one.kind in ("wall", o.kind)]
            same = _covered(one, others, config)
        if same and not one.fixed:
            dropped.add(i)
        else:
            near.keep(i)
    return dropped


class _Near:
    """The landmarks that are kept so far, by where they are: pairs of all would be too many."""

    def __init__(self, landmarks: Sequence[Placed], margin: float) -> None:
        self._all = landmarks
        self._kept = np.zeros(len(landmarks), dtype=bool)
        self._at = np.array([one.pose[:2] for one in landmarks]).reshape(-1, 2)
        self._low, self._high = (np.full((len(landmarks), 2), side) for side in (np.inf, -np.inf))
        for i, one in enumerate(landmarks):
            if len(one.segments):
                ends = one.segments.reshape(-1, 2)
                self._low[i], self._high[i] = ends.min(axis=0), ends.max(axis=0)
        self._margin = margin

    def keep(self, i: int) -> None:
        """A landmark is kept."""
        self._kept[i] = True

    def points(self, i: int) -> list[Placed]:
        """Those kept whose origins may be the same place as that of i."""
        off = np.abs(self._at - self._at[i]).max(axis=1)
        return self._chosen(self._kept & (off < _FARTHEST))

    def touching(self, i: int) -> list[Placed]:
        """Those kept whose segments may lie on those of i."""
        low, high = self._low[i] - self._margin, self._high[i] + self._margin
        return self._chosen(self._kept & (self._low < high).all(1) & (self._high > low).all(1))

    def _chosen(self, mask: NDArray[np.bool_]) -> list[Placed]:
        return [self._all[j] for j in mask.nonzero()[0].tolist()]


def _place(one: Placed) -> tuple[bool, bool, bool, float]:
    """What is judged first; a wall by itself only after all that may have it."""
    return not one.fixed, not one.inside, one.kind == "wall", -one.utility


def _again(one: Placed, others: Sequence[Placed], config: LandmarkConfig) -> bool:
    """Whether a landmark of the same kind lies there, with its material on the same side."""
    for other in others:
        if other.kind != one.kind or "x" not in other.binds:
            continue
        apart = float(np.hypot(*(one.pose[:2] - other.pose[:2])))
        sigma = float(np.hypot(one.sigma, other.sigma)) if one.area != other.area else 0.0
        near = apart < min(config.same + 2.0 * sigma, _FARTHEST)
        if near and one.material @ other.material > _ALIKE:
            return True
    return False


def _covered(one: Placed, others: Sequence[Placed], config: LandmarkConfig) -> bool:
    """Whether other landmarks have all segments of this one."""
    segments = [other.segments for other in others if len(other.segments)]
    if not segments or not len(one.segments):
        return False
    theirs = np.concatenate(segments)
    return all(_coverage(own, theirs, config) >= _COVERED for own in one.segments)


def _coverage(own: Array, theirs: Array, config: LandmarkConfig) -> float:
    """The share of a segment (2, 2) along which one of others (k, 2, 2) lies, facing alike."""
    run = own[1] - own[0]
    length = float(np.hypot(*run))
    if length == 0.0:
        return 1.0
    t = run / length
    n = np.array([t[1], -t[0]])
    d = theirs - own[0]
    along, off = d @ t, d @ n
    straight = along[:, 1] - along[:, 0] > np.cos(config.parallel) * np.hypot(
        along[:, 1] - along[:, 0], off[:, 1] - off[:, 0]
    )
    near = straight & (np.abs(off).max(axis=1) < config.same)
    steps = (np.arange(20) + 0.5) / 20 * length
    lo, hi = along[near].min(axis=1), along[near].max(axis=1)
    covered = ((lo[:, None] <= steps) & (steps <= hi[:, None])).any(axis=0)
    return float(covered.mean()) if near.any() else 0.0
