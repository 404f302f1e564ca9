"""Line segments of a block of scans, as arrays: the output of segmentation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

END_OPEN = 0  # cut by the field of view, the range limit or something nearer: "endless"
END_VERTEX = 1  # meets the next segment of the same surface: a corner's vertex
END_FREE = 2  # the surface truly ends here and what lies behind is farther: a jamb, a wall's end


@dataclass(frozen=True, slots=True)
class SegmentBlock:
    """All segments of the scans of one block, ordered by scan, then by beam; S segments.

    Everything is in the **robot's frame** at the scan's stamp (mount applied). Seen from the
    laser, a segment runs counterclockwise from `p1` to `p2`: the free side is on the left of
    p1 -> p2, the material on the right (a flipped mount is put right by the segmentation).

    scan: (S,) index of the scan in the block. first_beam, last_beam: (S,) the beams of the
        extreme points at p1 and p2; where beams run clockwise, or over the seam of a full circle,
        the first is the larger.
    p1, p2: (S, 2) end points on the line, projections of the extreme points; an END_FREE or
        END_VERTEX one is the middle between where the last beam meets the line and where the next
        one that is of something else does: the surface's end, without a bias inwards.
    alpha, d: (S,) Hesse form: the unit normal (cos alpha, sin alpha) points to the **material**
        side, and d = normal . point is the line's signed distance from the robot's origin.
    centre: (S, 2) weighted centre of the points; covariance: (S, 2, 2) of (alpha, d_c), where
        d_c is the offset along the normal **at the centre**: the two are uncorrelated there but
        for the sensor's bias terms, and move to any other reference point by the lever arm.
    points: (S,) number of points; length: (S,).
    end1, end2: (S,) END_OPEN, END_VERTEX or END_FREE.
    end_sigma: (S, 2) standard deviation along the line of each end point (beam spacing), about the
        surface's end where that is END_FREE or END_VERTEX.
    chi2: (S,) sum of squared residuals over their variances: points - 2 is expected of it.
    """

    scan: NDArray[np.int64]
    first_beam: NDArray[np.int64]
    last_beam: NDArray[np.int64]
    p1: Array
    p2: Array
    alpha: Array
    d: Array
    centre: Array
    covariance: Array
    points: NDArray[np.int64]
    length: Array
    end1: NDArray[np.int64]
    end2: NDArray[np.int64]
    end_sigma: Array
    chi2: Array
