"""What all scans that look at one piece of a wall have in common: the wall is no line.

A skirting, a radiator, a door leaf stand where they stand. However many scans see such a piece in
passing, its deviation from the wall's line stays, and averaging takes only the laser's part away:
the mean of n sights of one visit has the variance `(1 / n + share) sigma^2`. For the poses this
matters little, as scans on end see the same pieces and err alike; for what is believed of them it
is most of the error. So the weights that lead to the solution are those of single sights, and
those that lead to its covariance have the common part. How large it is the residuals tell.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.mapping.refinement.problem import in_g

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.mapping.keyscans import ScanSegments
    from hiermap_cli.mapping.refinement.problem import Matched, Noise, State, Terms

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

SHORTEST = 0.5  # metres of a piece
FEWEST_SIGHTS = 3  # of a piece that tells anything
FEWEST_PIECES = 3  # of such a wall: its line follows the mean of two whatever they are
SURE = 2.0  # standard errors by which a share must differ from none
VISIT = 24  # key scans without a sight, after which the piece is seen from elsewhere


class Pieces(NamedTuple):
    """P pieces of walls: which of them each of n sights shows, and the wall (P,) of each."""

    shown: Index
    wall: Index


def pieces(state: State, segments: ScanSegments, matched: Matched) -> Pieces:
    """Which sights are of the same piece: segments about as long, with their centres near by.

    A long segment has averaged over what it covers; it goes with others as long, in steps of two.
    """
    s, w = matched.segment, matched.wall
    W = state.walls.poses[w]
    d = in_g(state, segments, s, segments.centre[s]) - W[:, :2]
    along = np.cos(W[:, 2]) * d[:, 0] + np.sin(W[:, 2]) * d[:, 1]
    octave = np.ceil(np.log2(np.maximum(segments.length[s], SHORTEST))).astype(np.int64)
    place = np.floor(along * np.exp2(-octave)).astype(np.int64)
    # Wall, octave and place in one number: 64 octaves, 2^32 places.
    key = (w * 64 + (octave + 32) << 32) + place + (1 << 31)
    every, shown = np.unique(key, return_inverse=True)
    return Pieces(shown, every >> 38)


def common_share(z: Array, counted: Mask, pieces: Pieces) -> float:
    """The part of the variance that the sights of one piece have in common, 0 where none shows.

    What is told of an excess of the means' spread over what independent errors would have, less
    what chance may have done.

    Args:
        z: (n,) residuals over their sigmas.
        counted: (n,) without outliers, which tell nothing of the noise.
        pieces: what the sights show.
    """
    shown, P = pieces.shown[counted], len(pieces.wall)
    n = np.bincount(shown, minlength=P)
    mean = np.bincount(shown, z[counted], P) / np.maximum(n, 1)
    within = np.bincount(shown, np.square(z[counted] - mean[shown]), P) / np.maximum(n - 1, 1)
    told = n >= FEWEST_SIGHTS
    of_wall = np.bincount(pieces.wall[told], minlength=pieces.wall.max(initial=-1) + 1)[pieces.wall]
    told &= of_wall >= FEWEST_PIECES
    if np.count_nonzero(told) < 2:
        return 0.0
    # A wall's shift and turn have followed the means of its pieces.
    free = of_wall[told] / (of_wall[told] - 2)
    excess = free * (np.square(mean[told]) - within[told] / n[told])
    error = float(excess.std(ddof=1)) / np.sqrt(len(excess))
    return float(max(excess.mean() - SURE * error, 0.0))


def together(pieces: Pieces, scan: Index) -> Index:
    """(n,) how many sights of its piece the visit has to which each belongs.

    scan: (n,) the key scan of each.
    """
    order = np.lexsort((scan, pieces.shown))
    shown, at = pieces.shown[order], scan[order]
    begins = np.ones(len(order), dtype=bool)
    begins[1:] = (shown[1:] != shown[:-1]) | (at[1:] - at[:-1] > VISIT)
    visit = np.empty(len(order), dtype=np.int64)
    visit[order] = np.cumsum(begins) - 1
    return np.bincount(visit)[visit]


def with_common(
    walls: Terms,
    state: State,
    segments: ScanSegments,
    noise: Noise,
    matched: Matched,
    gate: float,
) -> Terms:
    """The terms of walls as they bear on the covariance.

    gate: chi-square beyond which a sight is an outlier.
    """
    if not len(matched.segment):
        return walls
    parts = pieces(state, segments, matched)
    sights = together(parts, walls.scan)
    variance = np.column_stack((noise.across, noise.heading))[matched.segment]
    information = walls.information.copy()
    for row, z in enumerate((walls.e / np.sqrt(variance)).T):
        share = common_share(z, walls.chi2 < gate, parts)
        information[:, row, row] /= 1.0 + share * sights
    return walls._replace(information=information)
