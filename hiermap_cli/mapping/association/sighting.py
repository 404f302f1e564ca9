"""How a scan's segments and ends lie to the walls and ends of an area.

The geometry of many small things is done in complex numbers, where a point is `x + i y` and a
rotation is a product: that takes fewer array operations, and these are what a scan costs.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.constraint import Rows
from hiermap_cli.geometry.points import planar, turning

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.estimation.stochastic_map import StochasticMap
    from hiermap_cli.perception.views import SegmentView

    Array = NDArray[np.float64]
    Complex = NDArray[np.complex128]
    Index = NDArray[np.int64]


class Frames(NamedTuple):
    """Frames of n objects in the area, in complex numbers, where a rotation is a product.

    table: (2, n) complex, the origins `x + i y` and `exp(-i theta)`, which turns what is seen
    along the area's axes into the object's: in one array, so that some objects are picked out at
    one stroke.
    """

    table: Complex

    @property
    def origin(self) -> Complex:
        """Origins, (n,)."""
        return np.asarray(self.table[0])

    @property
    def unturn(self) -> Complex:
        """`exp(-i theta)`, (n,)."""
        return np.asarray(self.table[1])

    def select(self, objects: Index) -> Frames:
        """The frames of some objects."""
        return Frames(self.table.take(objects, axis=1))

    def local(self, point: Complex | complex) -> Complex:
        """Points of the area, (n,) or one for all, each seen from its object."""
        return np.asarray((point - self.table[0]) * self.table[1])


def object_frames(V: StochasticMap, objects: Index | None = None) -> Frames:
    """The frames of all objects, or of those given (indices from 0)."""
    poses = V.poses[1:] if objects is None else V.poses.take(1 + objects, axis=0)
    table = np.empty((2, len(poses)), dtype=np.complex128)
    table[0], theta, unturn = planar(poses), poses[:, 2], table[1]
    np.cos(theta, out=unturn.real)
    np.sin(-theta, out=unturn.imag)
    return Frames(table)


class Viewpoint(NamedTuple):
    """Where the robot is in the area, from which a scan is seen: `x + i y` and `exp(i theta)`."""

    place: complex
    turn: complex

    @classmethod
    def of(cls, V: StochasticMap) -> Viewpoint:
        """As V has it."""
        x, y, theta = V.robot.tolist()
        return cls(complex(x, y), complex(math.cos(theta), math.sin(theta)))


class Matches(NamedTuple):
    """Segments and ends of a scan matched to objects.

    segment: (a,), wall: (a,) object index of each. end_segment, end_side: (b,) which end of
    which segment, end: (b,) its object index. Object indices count from 0.
    """

    segment: Index
    wall: Index
    end_segment: Index
    end_side: Index
    end: Index

    def empty(self) -> bool:
        """Whether nothing was matched."""
        return not len(self.wall) and not len(self.end)


class Seen(NamedTuple):
    """The s segments of a view in complex numbers, seen from the robot.

    centre: (s,). direction: (s,) `exp(i theta)`. ends: (s, 2).
    """

    centre: Complex
    direction: Complex
    ends: Complex

    @classmethod
    def of(cls, view: SegmentView) -> Seen:
        """Of a view."""
        return cls(planar(view.centre), turning(view.theta), planar(view.ends))


class Sighting(NamedTuple):
    """Matched segments and ends, and the frames of their objects.

    frames: of the a walls, then of the b ends. point: (a + b,) the segments' centres, then the
    ends, and direction: (a,) of the segments, seen from the robot.
    """

    frames: Frames
    point: Complex
    direction: Complex

    @classmethod
    def of(cls, frames: Frames, seen: Seen, matches: Matches) -> Sighting:
        """`frames`: those of all objects."""
        point, objects = seen.centre.take(matches.segment), matches.wall
        if len(matches.end):
            ends = seen.ends[matches.end_segment, matches.end_side]
            point = np.concatenate((point, ends))
            objects = np.concatenate((objects, matches.end))
        return cls(frames.select(objects), point, seen.direction.take(matches.segment))

    def select(self, pairs: Index, ends: Index) -> Sighting:
        """Some of the a pairs, and of the b ends."""
        which = np.concatenate((pairs, ends + len(self.direction)))
        return Sighting(
            self.frames.select(which), self.point.take(which), self.direction.take(pairs)
        )

    def from_objects(self, viewpoint: Viewpoint) -> tuple[Complex, Complex]:
        """Points (a + b,) and directions (a,) as they lie in the frames of their objects."""
        place, turn = viewpoint
        origin, unturn = self.frames.table
        point = (self.point * turn + place - origin) * unturn
        return point, self.direction * unturn[: len(self.direction)] * turn

    def innovations(self, viewpoint: Viewpoint) -> Array:
        """Of matched segments (y, theta at the wall's origin), then of ends (x), (2 a + b,)."""
        return _innovations(*self.from_objects(viewpoint))


def _innovations(point: Complex, direction: Complex) -> Array:
    a = len(direction)
    out = np.empty(a + len(point))
    x, y, cos, sin = point.real, point.imag, direction.real, direction.imag
    np.subtract(y[:a], sin / cos * x[:a], out=out[0 : 2 * a : 2])
    np.arctan2(sin, cos, out=out[1 : 2 * a : 2])
    out[2 * a :] = x[a:]
    return out


def match_rows(
    V: StochasticMap, sighting: Sighting, view: SegmentView, matches: Matches
) -> tuple[Rows, Array]:
    """The rows of matched segments and ends, and their noise R (k, k).

    Where each is measured minus where it is predicted, in the wall's or end's own frame. It
    shrinks with the robot's error, grows with the object's.
    """
    a, b = len(matches.wall), len(matches.end)
    k = 2 * a + b
    point, direction = sighting.from_objects(Viewpoint.of(V))
    origin, unturn = sighting.frames.table
    # Rows of Ad(X_l^-1): of walls y and theta, of ends x.
    H = np.zeros((k, 3))
    turn, foot = unturn.conj(), unturn * origin
    H_xy, H_theta = planar(H), H[:, 2]
    np.multiply(turn[:a], 1j, out=H_xy[0 : 2 * a : 2])
    H_theta[0 : 2 * a : 2] = foot.real[:a]
    H_theta[1 : 2 * a : 2] = 1.0
    H_xy[2 * a :] = turn[a:]
    np.negative(foot.imag[a:], out=H_theta[2 * a :])
    pose = np.empty(k, dtype=np.int64)
    pose[0 : 2 * a : 2] = pose[1 : 2 * a : 2] = matches.wall
    pose[2 * a :] = matches.end
    pose += 1
    rows = Rows(_innovations(point, direction), pose, H, np.zeros((k, len(V.parameters))))
    return rows, _match_noise(point.real[:a], view, matches)


def _match_noise(arm: Array, view: SegmentView, matches: Matches) -> Array:
    """R (k, k) of `match_rows`.

    A segment's line noise carried from its centre to the wall's origin by the lever arm between
    them, (a,).
    """
    a, b = len(matches.wall), len(matches.end)
    k = 2 * a + b
    R = np.zeros((k, k))
    # Views of the diagonal and of what stands beside it.
    diagonal, above, below = R.ravel()[:: k + 1], R.ravel()[1 :: k + 1], R.ravel()[k :: k + 1]
    var_theta = view.var_theta.take(matches.segment)
    R_yt = -arm * var_theta
    diagonal[0 : 2 * a : 2] = view.var_y.take(matches.segment) - arm * R_yt
    diagonal[1 : 2 * a : 2] = var_theta
    above[0 : 2 * a : 2] = below[0 : 2 * a : 2] = R_yt
    diagonal[2 * a :] = np.square(view.end_sigma[matches.end_segment, matches.end_side])
    return R
