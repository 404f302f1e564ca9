"""Line segments out of blocks of scans (section 4): the way from ranges to `SegmentBlock`.

All scans of a block go through each step together, so that the cost a scan is that of a few
hundred array operations divided by the block's length.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry.se2 import wrap
from hiermap_cli.perception.beams import arrange, concatenated_ranges
from hiermap_cli.perception.boundaries import clear_seam, place_boundaries
from hiermap_cli.perception.breakpoints import breakpoints, shown_noise
from hiermap_cli.perception.ends import describe_ends
from hiermap_cli.perception.fitting import fit_moments, gather, refine
from hiermap_cli.perception.merging import merge
from hiermap_cli.perception.segments import SegmentBlock
from hiermap_cli.perception.splitting import split
from hiermap_cli.perception.tails import gain_points, inner_lines

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig, SegmentationConfig
    from hiermap_cli.logs.records import Mount, ScanBlock
    from hiermap_cli.perception.beams import Beams
    from hiermap_cli.perception.fitting import Fit, Lines, Members
    from hiermap_cli.perception.pieces import Pieces

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]
    Mask = NDArray[np.bool_]

NOISELESS = 2e-5  # metres of noise below which ranges come from no real sensor
LASTING = 0.8  # of `min_length`: what is shorter gets no longer by losing points at its ends

# glibc gives freed arrays of more than 128 kB back to the system, and every new one then costs its
# page faults: half of all the time here. A large block freed once, never touched, raises that
# bound to its own size (mallopt(3), M_MMAP_THRESHOLD) for the life of the process.
np.empty(31 << 20, dtype=np.uint8)


def segment_block(block: ScanBlock, laser: LaserConfig, config: SegmentationConfig) -> SegmentBlock:
    """All straight segments of the block's scans, in the robot's frame; see `SegmentBlock`.

    Args:
        block: B scans of one geometry.
        laser: noise and limits of the ranges.
        config: thresholds of split and merge.
    """
    beams = arrange(block, laser, config.max_range)
    if not len(beams.cell):
        return _empty()
    noise, floors = laser, config
    if shown_noise(beams) < NOISELESS:
        # Nothing is uneven in a simulation without noise: no bend is too small to be a corner.
        noise = laser.model_copy(update={"sigma_range": NOISELESS, "sigma_range_scale": 0.0})
        floors = config.model_copy(update={"split_floor": NOISELESS})
    breaks = breakpoints(beams, laser, config)
    runs = split(beams, breaks, noise, floors)
    pieces = merge(beams, breaks, runs, noise, floors)
    if not len(pieces.first):
        return _empty()
    members = _members(beams, breaks, pieces, noise, floors)
    if not len(members.starts):
        return _empty()
    lines, dropped = inner_lines(members, noise)
    first, last = members.starts + dropped[:, 0], members.starts + members.counts - dropped[:, 1]
    fit = _final_fit(members, lines, first, last, laser, config)
    begin, end = members.point[first], members.point[last - 1]
    long = _square_lengths(beams, begin, end) >= config.min_length**2
    whole = np.flatnonzero(long & (last - first >= config.min_points))
    begin, end, counts = begin[whole], end[whole], (last - first)[whole]
    return _describe(beams, fit.take(whole), begin, end, counts, block.mount, noise, floors)


def _members(
    beams: Beams,
    breaks: Mask,
    pieces: Pieces,
    laser: LaserConfig,
    config: SegmentationConfig,
) -> Members:
    """The points of each segment: corners shared out, and single ones gained.

    Half of all pieces are too short to be segments: what follows is not done for them.
    """
    first, last = place_boundaries(beams, breaks, pieces, laser, config)
    if beams.cyclic:
        first, last = clear_seam(beams, pieces, first, last)
    owner = pieces.run_segment
    lines, _ = fit_moments(pieces.sums)
    first, last = gain_points(beams, breaks, lines.take(owner), first, last, laser, config)
    # Of a wall across the seam the runs before the seam come first.
    order = np.argsort(2 * owner + (pieces.run_first < pieces.first[owner]), kind="stable")
    first, last, owner = first[order], last[order], owner[order]
    # Beside what stands before a wall, the last point may be of neither.
    parted = (owner[1:] == owner[:-1]) & (np.abs(first[1:] - last[:-1]) > 1)
    last[:-1] -= parted & (last[:-1] - first[:-1] > 2)
    first[1:] += parted & (last[1:] - first[1:] > 2)
    run_counts = np.maximum(last - first + 1, 0)
    # The runs of each segment, and its points.
    closing = np.flatnonzero(np.append(owner[1:] != owner[:-1], True))
    opening = np.append(0, closing[:-1] + 1)
    counts = np.add.reduceat(run_counts, opening)
    least = (LASTING * config.min_length) ** 2
    long = _square_lengths(beams, first[opening], last[closing]) >= least
    chosen = np.flatnonzero(long & (counts >= config.min_points))
    runs = concatenated_ranges(opening[chosen], (closing - opening + 1)[chosen])
    points = concatenated_ranges(first[runs], run_counts[runs])
    return gather(beams, points, counts[chosen])


def _square_lengths(beams: Beams, first: Index, last: Index) -> Array:
    """Squared distances between points `first` and `last`, (K,)."""
    x, y = beams.x.take(last), beams.y.take(last)
    x -= beams.x.take(first)
    y -= beams.y.take(first)
    return x * x + y * y


def _final_fit(
    members: Members,
    lines: Lines,
    first: Index,
    last: Index,
    laser: LaserConfig,
    config: SegmentationConfig,
) -> Fit:
    """Maximum likelihood lines of the points `first` to `last` (exclusive); outliers do not count.

    Walls are not lines: where the residuals are larger than the sensor's noise can make them
    (their chi-square by more than five sigmas), what exceeds it is taken for white unevenness of
    the wall, and the fit is weighted and its covariance stated with it.
    """
    keep, counts = members.between(first, last), last - first
    fit = refine(members, lines, laser, keep)
    freedom = np.maximum(counts - 2.0, 1.0)
    ratio = fit.residual * fit.residual
    ratio /= fit.variance
    bound = config.outlier_sigmas**2 * np.maximum(fit.chi2 / freedom, 1.0)
    off = np.flatnonzero(keep & (ratio > members.spread(bound)))
    again = _is_rough(fit.chi2, freedom)
    again[np.searchsorted(members.starts, off, side="right") - 1] = True
    if not again.any():
        return fit
    keep[off] = False
    members, here = members.of(again)
    keep = keep[here]
    freedom = np.maximum(members.total(keep) - 2.0, 1.0)
    square = fit.residual[here] ** 2
    excess = (members.total(square * keep) - members.total(fit.variance[here] * keep)) / freedom
    rough = _is_rough(members.total(ratio[here] * keep), freedom)
    uneven = np.where(rough, np.maximum(excess, 0.0), 0.0)
    better = refine(members, fit.lines.take(again), laser, keep, uneven)
    for old, new in zip((*fit.lines, *fit[1:5]), (*better.lines, *better[1:5]), strict=True):
        old[again] = new
    return fit


def _is_rough(chi2: Array, freedom: Array) -> Mask:
    """Whether residuals are larger than noise makes them: by five sigmas of their chi-square."""
    return np.asarray(chi2 > freedom + 5.0 * np.sqrt(2.0 * freedom) + 10.0)


def _describe(
    beams: Beams,
    fit: Fit,
    begin: Index,
    end: Index,
    counts: Index,
    mount: Mount,
    laser: LaserConfig,
    config: SegmentationConfig,
) -> SegmentBlock:
    """The segments with their ends, in the robot's frame."""
    lines = fit.lines
    ends = describe_ends(beams, begin, end, fit, laser, config)
    origin = np.array([mount.x, mount.y])
    nx, ny, d = lines
    covariance = np.zeros((len(begin), 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = fit.var_alpha, fit.var_d
    points = np.stack((ends.x, ends.y), axis=2) + origin  # (2, K, 2)
    return SegmentBlock(
        scan=beams.cell[begin] // beams.ranges.shape[1],
        first_beam=beams.beam(beams.cell[begin]),
        last_beam=beams.beam(beams.cell[end]),
        p1=points[0],
        p2=points[1],
        alpha=wrap(np.arctan2(ny, nx)),
        d=d + nx * origin[0] + ny * origin[1],
        centre=np.stack((fit.cx, fit.cy), axis=1) + origin,
        covariance=covariance,
        points=counts,
        length=np.hypot(*(points[1] - points[0]).T),
        end1=ends.kind[0],
        end2=ends.kind[1],
        end_sigma=ends.sigma.T,
        chi2=fit.chi2,
    )


def _empty() -> SegmentBlock:
    """No segments."""
    none = np.zeros(0, dtype=np.int64)
    pairs = np.zeros((0, 2))
    return SegmentBlock(
        scan=none,
        first_beam=none,
        last_beam=none,
        p1=pairs,
        p2=pairs,
        alpha=np.zeros(0),
        d=np.zeros(0),
        centre=pairs,
        covariance=np.zeros((0, 2, 2)),
        points=none,
        length=np.zeros(0),
        end1=none,
        end2=none,
        end_sigma=pairs,
        chi2=np.zeros(0),
    )
