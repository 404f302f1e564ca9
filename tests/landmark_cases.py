"""Walls for the tests of landmarks: sets of lines, and where they are the same seen elsewhere."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.config import LandmarkConfig
from hiermap_cli.geometry import points
from hiermap_cli.geometry.lines import hesse_from_points
from hiermap_cli.perception.kinds import rule_sets
from hiermap_cli.perception.kinds.lineset import NO_PASSAGES, LineSet, along_of
from hiermap_cli.perception.kinds.rules import Extraction, Group, RuleSet, find_groups
from hiermap_cli.perception.segments import END_FREE, END_OPEN

if TYPE_CHECKING:
    from collections.abc import Sequence

CONFIG = LandmarkConfig()

# Each from p1 to p2, the free side on the left.
ROOM = np.array([[[0, 0], [5, 0]], [[5, 0], [5, 4]], [[5, 4], [0, 4]], [[0, 4], [0, 0]]], float)
PILLAR = np.array([[[2, 2], [2, 3]], [[2, 3], [3.5, 3]], [[3.5, 3], [3.5, 2]], [[3.5, 2], [2, 2]]])
DOOR = np.array([[[0, 0], [2, 0]], [[2.9, 0], [6, 0]]])
CORRIDOR = np.array([[[0, 0], [7, 0]], [[6.5, 1.8], [-0.5, 1.8]]])
CROSSING = np.array(
    [[[0, 0], [3, 0]], [[3, 0], [3, -2.5]], [[5, -2.5], [5, 0]], [[5, 0], [9, 0]], [[9, 2], [0, 2]]]
)
WALL = np.array([[[1.0, 2.0], [4.0, 3.0]]])
ALL = {
    "corner_concave": ROOM,
    "corner_convex": PILLAR,
    "door": DOOR,
    "corridor": CORRIDOR,
    "crossing": CROSSING,
    "wall": WALL,
}


def lines_of(
    segments: np.ndarray,
    *,
    kind: Sequence[Sequence[int]] | None = None,
    rng: np.random.Generator | None = None,
    sigma: float = 0.005,
    passages: np.ndarray = NO_PASSAGES,
) -> LineSet:
    """Segments (n, 2, 2) as lines, all ends true unless `kind` says otherwise, with a joint
    covariance that has all correlations."""
    segments = np.asarray(segments, dtype=float)
    n = len(segments)
    hesse = hesse_from_points(segments[:, 0], segments[:, 1])
    kinds = np.full((n, 2), END_FREE) if kind is None else np.array(kind)
    C = np.diag(np.full(4 * n, sigma**2))
    if rng is not None:
        A = rng.normal(size=(4 * n, 4 * n)) * sigma
        C = A @ A.T / (4 * n) + 0.1 * C
    is_open = np.zeros((n, 4), dtype=bool)
    is_open[:, 2:] = kinds == END_OPEN
    C[is_open.ravel()] = 0.0
    C[:, is_open.ravel()] = 0.0
    along = along_of(hesse[:, None], segments)
    return LineSet(hesse, along, kinds, np.full(n, 5), C, passages)


def seen_from(segments: np.ndarray, R_r_w: np.ndarray) -> np.ndarray:
    """The same segments in another frame."""
    return points.h(R_r_w, np.asarray(segments, dtype=float))


def perturbed(lines: LineSet, e: np.ndarray) -> LineSet:
    """The lines with their parameters (alpha, d, s1, s2) changed by `e` (4 n,)."""
    steps = e.reshape(-1, 4)
    return replace(lines, hesse=lines.hesse + steps[:, :2], along=lines.along + steps[:, 2:])


def found(
    lines: LineSet, kind: str | None = None, config: LandmarkConfig = CONFIG
) -> list[tuple[RuleSet, Group, Extraction]]:
    """All landmarks of the lines, or those of one kind."""
    return [
        (rule, group, rule.extract(lines, group))
        for rule, group in find_groups(lines, rule_sets(), config)
        if kind is None or group.kind == kind
    ]
