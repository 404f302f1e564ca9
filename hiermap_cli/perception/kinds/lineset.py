"""The lines that landmarks are made of: a scan's segments, or an area's walls.

The same rules find landmarks in both. Line i has four parameters, at 4 i of the joint vector:
`(alpha, d, s1, s2)`, its Hesse form with the normal to the material and where its ends p1 and p2
lie along it, from the foot of the perpendicular from the frame's origin, in the direction from
p1 to p2 (the free side is on the left).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry.lines import hesse_D_centred
from hiermap_cli.geometry.se2 import wrap
from hiermap_cli.perception.segments import END_OPEN

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

NO_PASSAGES = np.zeros((0, 4))
NO_PASSAGES.flags.writeable = False


@dataclass(frozen=True)
class LineSet:
    """n lines in one frame.

    hesse: (n, 2) alpha and d. along: (n, 2) s1 and s2. kind: (n, 2) of the ends, END_OPEN where
    s is only how far the line was seen. seen: (n,) sightings. covariance: (4 n, 4 n) joint, of
    (alpha, d, s1, s2) line by line; an open end's rows are zero. passages: (m, 4) x, y, theta
    and width of narrow places that the robot went through: midway between the jambs, X along
    them, Y out of this frame's area.
    """

    hesse: Array
    along: Array
    kind: Index
    seen: Index
    covariance: Array
    passages: Array = field(default_factory=lambda: NO_PASSAGES)

    def __len__(self) -> int:
        return len(self.hesse)

    @cached_property
    def theta(self) -> Array:
        """Headings from p1 to p2, (n,)."""
        return wrap(self.hesse[:, 0] + 0.5 * np.pi)

    @cached_property
    def length(self) -> Array:
        """Metres from p1 to p2, (n,)."""
        return self.along[:, 1] - self.along[:, 0]

    @cached_property
    def ends(self) -> Array:
        """p1 and p2 as points, (n, 2, 2)."""
        return point_on(self.hesse[:, None], self.along)

    def columns(self, lines: tuple[int, ...]) -> Index:
        """Where the parameters of some lines lie in the joint vector, (4 k,)."""
        return (4 * np.array(lines, dtype=np.int64)[:, None] + np.arange(4)).ravel()


def point_on(hesse: Array, s: Array) -> Array:
    """The point (..., 2) at `s` (...) along lines (..., 2)."""
    c, n = np.cos(hesse[..., 0]), np.sin(hesse[..., 0])
    d = hesse[..., 1]
    return np.stack((d * c - s * n, d * n + s * c), axis=-1)


def point_on_D_line(hesse: Array, s: Array) -> Array:
    """d point_on / d (alpha, d, s), shape (..., 2, 3)."""
    c, n = np.cos(hesse[..., 0]), np.sin(hesse[..., 0])
    d = hesse[..., 1]
    x = np.stack((-d * n - s * c, c, -n), axis=-1)
    y = np.stack((d * c - s * n, n, c), axis=-1)
    return np.stack((x, y), axis=-2)


def along_of(hesse: Array, points: Array) -> Array:
    """s (...) of points (..., 2), projected on lines (..., 2)."""
    return np.asarray(
        np.cos(hesse[..., 0]) * points[..., 1] - np.sin(hesse[..., 0]) * points[..., 0]
    )


def offset_of(hesse: Array, points: Array) -> Array:
    """How far points (..., 2) lie off lines (..., 2) towards their material, (...)."""
    c, n = np.cos(hesse[..., 0]), np.sin(hesse[..., 0])
    return np.asarray(c * points[..., 0] + n * points[..., 1] - hesse[..., 1])


def foot(hesse: Array, point: Array) -> Array:
    """The point (2,) of a line that is nearest to a fixed point."""
    normal = np.array([np.cos(hesse[0]), np.sin(hesse[0])])
    on_line: Array = point - offset_of(hesse, point) * normal
    return on_line


def foot_D_line(hesse: Array, point: Array) -> Array:
    """d foot / d (alpha, d), (2, 2)."""
    n = np.array([np.cos(hesse[0]), np.sin(hesse[0])])
    t = np.array([-n[1], n[0]])
    return np.column_stack(((hesse[1] - n @ point) * t - (t @ point) * n, n))


def scan_lines(view: SegmentView) -> LineSet:
    """The segments of one scan as lines in the robot's frame.

    A segment's angle and offset are independent at its centre, and so are its ends along it; at
    the frame's origin they are not: d has the lever arm of the centre, and `s = t . P` turns
    with the line, `ds = du - d dalpha`.
    """
    n = len(view.length)
    alpha = wrap(view.theta - 0.5 * np.pi)
    d = np.cos(alpha) * view.centre[:, 0] + np.sin(alpha) * view.centre[:, 1]
    hesse = np.column_stack((alpha, d))
    J = np.zeros((n, 4, 4))
    J[:, :2, :2] = hesse_D_centred(alpha, view.centre)
    J[:, 2:, 0] = -d[:, None]
    J[:, 2, 2] = J[:, 3, 3] = 1.0
    known = view.end_kind != END_OPEN
    J[:, 2:] *= known[:, :, None]
    variances = np.column_stack((view.var_theta, view.var_y, view.end_sigma**2))
    blocks = J @ (variances[:, :, None] * J.transpose(0, 2, 1))
    covariance = np.zeros((4 * n, 4 * n))
    for i in range(n):
        covariance[4 * i : 4 * i + 4, 4 * i : 4 * i + 4] = blocks[i]
    return LineSet(
        hesse=hesse,
        along=along_of(hesse[:, None], view.ends),
        kind=view.end_kind,
        seen=np.ones(n, dtype=np.int64),
        covariance=covariance,
    )
