"""Line segments out of blocks of scans (section 4): the way from ranges to `SegmentBlock`.

All scans of a block go through each step together, so that the cost a scan is that of a few
hundred array operations divided by the block's length.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry.se2 import wrap
from hiermap_cli.perception.beams import arrange, concatenated_ranges
from hiermap_cli.perception.breakpoints import breakpoints
from hiermap_cli.perception.ends import describe_ends
from hiermap_cli.perception.fitting import fit_moments, point_moments, prefix_sums, refine
from hiermap_cli.perception.segments import SegmentBlock
from hiermap_cli.perception.splitting import keep_segments, merge, split
from hiermap_cli.perception.trimming import core_mask, place_boundaries, tails_to_drop

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LaserConfig, SegmentationConfig
    from hiermap_cli.logs.records import ScanBlock
    from hiermap_cli.perception.beams import Beams
    from hiermap_cli.perception.fitting import Fit
    from hiermap_cli.perception.splitting import Pieces

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]


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
    breaks = breakpoints(beams, laser, config)
    sums, values = prefix_sums(beams), point_moments(beams)
    runs = split(beams, breaks, laser, config)
    pieces = merge(beams, sums, values, runs, laser, config)
    pieces = keep_segments(pieces, pieces.sums[0] >= config.min_points)
    if not len(pieces.first):
        return _empty()
    first, last = place_boundaries(beams, sums, values, breaks, pieces)
    return _measure(beams, block, pieces, first, last, laser, config)


def _measure(
    beams: Beams,
    block: ScanBlock,
    pieces: Pieces,
    first: Index,
    last: Index,
    laser: LaserConfig,
    config: SegmentationConfig,
) -> SegmentBlock:
    """Final fits, ends and filters of the segments whose runs are `first..last`."""
    order = np.lexsort((first, pieces.run_segment))
    first, last, owner = first[order], last[order], pieces.run_segment[order]
    index = concatenated_ranges(first, last - first + 1)
    segment = np.repeat(owner, last - first + 1)
    index, segment, starts, _ = _gather(index, segment, config.min_points)
    if not len(starts):
        return _empty()

    # Lines of the inner points judge the tails; two steps reach full accuracy.
    counts = np.diff(starts, append=len(index))
    lines = fit_moments(np.add.reduceat(point_moments(beams)[:, index], starts, axis=1))
    core = core_mask(starts, counts)
    for _ in range(2):
        lines = refine(beams, index, starts, lines, laser, keep=core).lines
    nx, ny, d = (np.repeat(v, counts) for v in lines)
    x, y = beams.x[index], beams.y[index]
    residual = nx * x + ny * y - d
    cosine = np.maximum(nx * beams.dx[index] + ny * beams.dy[index], 0.01)
    kept = tails_to_drop(index, starts, residual, cosine, nx * y - ny * x)
    segment = np.repeat(np.arange(len(starts)), counts)
    index, segment, starts, ids = _gather(index[kept], segment[kept], config.min_points)
    lines = lines.take(ids)
    if not len(starts):
        return _empty()
    counts = np.diff(starts, append=len(index))
    fit = refine(beams, index, starts, lines, laser)
    lines = fit.lines
    fit = refine(beams, index, starts, lines, laser)
    uneven, keep = _unevenness(fit, starts, counts, config)
    fit = refine(beams, index, starts, lines, laser, uneven, keep)
    fit = refine(beams, index, starts, fit.lines, laser, uneven, keep)

    begin, end = index[starts], index[starts + counts - 1]
    extent = np.hypot(beams.x[end] - beams.x[begin], beams.y[end] - beams.y[begin])
    good = np.flatnonzero(extent >= config.min_length)
    begin, end, counts = begin[good], end[good], counts[good]
    lines = fit.lines.take(good)
    ends = describe_ends(beams, begin, end, lines, laser, config)
    mount = np.array([block.mount.x, block.mount.y])
    nx, ny, d = lines
    covariance = np.zeros((len(good), 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = fit.var_alpha[good], fit.var_d[good]
    points = np.stack((ends.x, ends.y), axis=2) + mount
    return SegmentBlock(
        scan=beams.cell[begin] // beams.ranges.shape[1],
        first_beam=beams.beam(beams.cell[begin]),
        last_beam=beams.beam(beams.cell[end]),
        p1=points[:, 0],
        p2=points[:, 1],
        alpha=wrap(np.arctan2(ny, nx)),
        d=d + nx * mount[0] + ny * mount[1],
        centre=np.stack((fit.cx, fit.cy), axis=1)[good] + mount,
        covariance=covariance,
        points=counts,
        length=np.hypot(*(points[:, 1] - points[:, 0]).T),
        end1=ends.kind[:, 0],
        end2=ends.kind[:, 1],
        end_sigma=ends.sigma,
    )


def _gather(index: Index, segment: Index, least: int) -> tuple[Index, Index, Index, Index]:
    """Points of the segments that have at least `least`: index, segment, starts, segment ids."""
    enough = (np.bincount(segment, minlength=1) >= least)[segment]
    index, segment = index[enough], segment[enough]
    starts = np.flatnonzero(np.diff(segment, prepend=-1))
    return index, segment, starts, segment[starts]


def _unevenness(
    fit: Fit, starts: Index, counts: Index, config: SegmentationConfig
) -> tuple[Array, NDArray[np.bool_]]:
    """Variance of each wall itself beyond the sensor's noise (K,), and the points that count (M,).

    Walls are not lines: where the residuals are larger than the noise can explain (beyond five
    sigmas of their chi-square), what exceeds it is taken for white unevenness of the wall.
    """
    square = fit.residual**2
    freedom = np.maximum(counts - 2, 1)
    chi = np.sqrt(np.add.reduceat(square * fit.weight, starts) / freedom)
    bound = config.outlier_sigmas * np.repeat(np.maximum(chi, 1.0), counts)
    keep = square * fit.weight <= bound * bound
    kept = square * keep
    freedom = np.maximum(np.add.reduceat(keep.astype(np.int64), starts) - 2, 1)
    chi2 = np.add.reduceat(kept * fit.weight, starts)
    rough = chi2 > freedom + 5.0 * np.sqrt(2.0 * freedom) + 10.0
    excess = np.add.reduceat(kept - keep / fit.weight, starts) / freedom
    return np.where(rough, np.maximum(excess, 0.0), 0.0), keep


def _empty() -> SegmentBlock:
    """No segments."""
    none = np.zeros(0, dtype=np.int64)
    return SegmentBlock(
        none,
        none,
        none,
        np.zeros((0, 2)),
        np.zeros((0, 2)),
        np.zeros(0),
        np.zeros(0),
        np.zeros((0, 2)),
        np.zeros((0, 2, 2)),
        none,
        np.zeros(0),
        none,
        none,
        np.zeros((0, 2)),
    )
