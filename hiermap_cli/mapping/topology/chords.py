"""Chords across the path: how narrow it is at a point, and between which ends of beams."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry import se2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

WIDEST = 1.6  # metres from a point of the path in which a jamb is looked for
SECTORS = 48
OPPOSITE = 2  # sectors by which the two jambs may miss opposite directions
# The sectors that lie across from each, in columns.
ACROSS = (np.arange(SECTORS) + np.arange(-OPPOSITE, OPPOSITE + 1)[:, None] + SECTORS // 2) % SECTORS

_NOTHING_NEAR = np.full(SECTORS + 1, WIDEST)


def narrowest_chord(point: Array, ends: Array, most: float = 2.0 * WIDEST) -> tuple[float, Array]:
    """The narrowest chord through a point between beams' ends: its length, its ends (2, 2).

    Ends beyond `WIDEST` do not count: the longest chord is twice that. Where none is as short as
    `most` the longest is told, with its ends in the point.
    """
    x, y = ends[:, 0] - point[0], ends[:, 1] - point[1]
    r2 = x * x + y * y
    shortest = math.sqrt(r2.min(initial=WIDEST * WIDEST))
    if 2.0 * shortest > most:
        return 2.0 * WIDEST, np.array((point, point))
    # Even with the nearest end of all, one farther than this makes a chord that is too long.
    near = (r2 < min(WIDEST, most - shortest) ** 2).nonzero()[0]
    x, y, r = x[near], y[near], np.sqrt(r2[near])
    sector = ((np.arctan2(y, x) + np.pi) * (SECTORS / (2.0 * np.pi))).astype(np.int64)
    nearest = _NOTHING_NEAR.copy()
    np.minimum.at(nearest, sector, r)
    nearest[0] = min(nearest[0], nearest[SECTORS])  # where the angle is pi
    across = nearest[ACROSS]
    chord = nearest[:SECTORS] + across.min(axis=0)
    i = int(chord.argmin())
    if chord[i] > most:
        return 2.0 * WIDEST, np.array((point, point))
    j = int(ACROSS[across[:, i].argmin(), i])
    jambs = np.empty((2, 2))
    for k, b in enumerate((j, i)):
        if nearest[b] < WIDEST:
            as_near = (r == nearest[b]).nonzero()[0].tolist()
            at = next(n for n in as_near if sector[n] % SECTORS == b)
            jambs[k] = point[0] + x[at], point[1] + y[at]
        else:
            angle = 2.0 * np.pi * (b + 0.5) / SECTORS - np.pi
            jambs[k] = point + WIDEST * np.array([np.cos(angle), np.sin(angle)])
    return float(chord[i]), jambs


def chord_frame(jambs: Array, heading: Array) -> Array:
    """A frame (3,) midway between two jambs (2, 2), X along them, Y as the path goes (2,)."""
    along = jambs[1] - jambs[0]
    theta = float(np.arctan2(along[1], along[0]))
    if along[0] * heading[1] - along[1] * heading[0] < 0.0:
        theta += np.pi
    middle = jambs.mean(axis=0)
    return np.array([middle[0], middle[1], se2.wrap(np.array(theta))])
