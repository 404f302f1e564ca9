"""Areas that are one: the maps of several areas of the filter in one frame.

The filter begins a new area where its state has grown large, or where it does not know that it
is back in an old one; what people see as one room may so lie in several areas. Their errors are
independent, but for the places that they share: with an anchor in each at the same place,
`X_a = R_a_b X_b`, the frame of one is known in the other, and all errors of the joined map are
linear in those of its parts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.gaussian import symmetrise
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import AreaMap, joined
from hiermap_cli.mapping.portals import anchor_index

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.mapping.portals import Portal

    Array = NDArray[np.float64]


class JoinedArea(NamedTuple):
    """An area of the result.

    map: V and features of all its parts, in the frame of the first. parts: indices of the
    filter's areas. R_0_p: (k, 3) the parts' frames in the first one's. offset: (k,) by how much
    the uids of each part were raised.
    """

    map: AreaMap
    parts: tuple[int, ...]
    R_0_p: Array
    offset: tuple[int, ...]

    def uid(self, part: int, uid: int) -> int:
        """The uid here of an object of one of the filter's areas."""
        return uid + self.offset[self.parts.index(part)]


def join(
    maps: Sequence[AreaMap], portals: Sequence[Portal], parts: Sequence[int], last: int
) -> JoinedArea:
    """Joins areas of the filter that portals among them connect.

    Args:
        maps: all areas of the filter.
        portals: all portals.
        parts: the areas to join, in the order of the result.
        last: that one of them in which the robot was last, whose robot is the joined area's.

    Raises:
        ValueError: no portals connect the parts.
    """
    if len(parts) == 1:
        return JoinedArea(maps[parts[0]], (parts[0],), np.zeros((1, 3)), (0,))
    sizes = [len(maps[p].V.covariance) for p in parts]
    starts = dict(zip(parts, np.concatenate(([0], np.cumsum(sizes)[:-1])).tolist(), strict=True))
    total = sum(sizes)
    R, D = _frames(maps, portals, parts, starts, total)
    poses, rows = [], []
    for p in parts:
        V = maps[p].V
        for i in range(1, len(V.poses)):
            poses.append(se2.compose(R[p], V.poses[i]))
            rows.append(D[p] + _row(maps[p], i, R[p], starts[p], total))
    V = maps[last].V
    m = len(V.parameters)
    robot = D[last] + _row(maps[last], 0, R[last], starts[last], total)
    calibration = np.zeros((m, total))
    calibration[:, starts[last] + 3 : starts[last] + 3 + m] = np.eye(m)
    J = np.concatenate((robot, calibration, *rows))
    X = np.array([se2.compose(R[last], V.robot), *poses])
    if V.coordinates == "additive":
        for k, block in enumerate(se2.additive_D_invariant(X)):
            at = slice(0, 3) if k == 0 else slice(m + 3 * k, m + 3 * k + 3)
            J[at] = block @ J[at]
    C = np.zeros((total, total))
    for p, size in zip(parts, sizes, strict=True):
        C[starts[p] : starts[p] + size, starts[p] : starts[p] + size] = maps[p].V.covariance
    V = V._replace(poses=X, covariance=symmetrise(J @ C @ J.T))
    features, offset = maps[parts[0]].features, [0]
    for p in parts[1:]:
        f = maps[p].features
        up = offset[-1] + maps[parts[len(offset) - 1]].next_uid
        offset.append(up)
        wall = np.where(f.wall >= 0, f.wall + up, -1)
        features = joined(features, f._replace(uid=f.uid + up, wall=wall))
    whole = AreaMap(V, features, offset[-1] + maps[parts[-1]].next_uid)
    return JoinedArea(whole, tuple(parts), np.array([R[p] for p in parts]), tuple(offset))


def _row(area: AreaMap, i: int, R: Array, start: int, total: int) -> Array:
    """d (invariant error of pose i, seen from the frame in which the area's is at R) / d all."""
    V = area.V
    row = np.zeros((3, total))
    where = V.columns(i)
    T = V.invariant_D_error(V.poses[i])
    row[:, start + where.start : start + where.stop] = se2.adjoint(R) @ T
    return row


def _frames(
    maps: Sequence[AreaMap],
    portals: Sequence[Portal],
    parts: Sequence[int],
    starts: dict[int, int],
    total: int,
) -> tuple[dict[int, Array], dict[int, Array]]:
    """The frame of every part in the first one's, and its invariant error by all errors."""
    R = {parts[0]: np.zeros(3)}
    D = {parts[0]: np.zeros((3, total))}
    inside = [p for p in portals if p.a in starts and p.b in starts]
    while len(R) < len(parts):
        grown = False
        for portal in inside:
            for here, i, there, j in (
                (portal.a, portal.anchor_a, portal.b, portal.anchor_b),
                (portal.b, portal.anchor_b, portal.a, portal.anchor_a),
            ):
                if here not in R or there in R:
                    continue
                k, l = anchor_index(maps[here], i), anchor_index(maps[there], j)
                X, Y = maps[here].V.poses[k], maps[there].V.poses[l]
                R[there] = se2.compose(R[here], se2.compose(X, se2.invert(Y)))
                D[there] = D[here] + _row(maps[here], k, R[here], starts[here], total)
                D[there] = D[there] - _row(maps[there], l, R[there], starts[there], total)
                grown = True
        if not grown:
            raise ValueError(f"no portals connect the areas {sorted(parts)}")
    return R, D
