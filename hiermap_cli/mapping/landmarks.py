"""From an area's walls and ends to its landmarks, each with its own model (section 4)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.gaussian import symmetrise
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import WALL
from hiermap_cli.mapping.model import Estimate, LandmarkModel, SegmentFeature

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.estimation.stochastic_map import StochasticMap
    from hiermap_cli.mapping.area_map import Features

    Array = NDArray[np.float64]


class AreaLandmarks(NamedTuple):
    """An area's landmarks, their poses (k, 3) in it, and the joint C(V) of (robot, poses)."""

    landmarks: tuple[LandmarkModel, ...]
    poses: Array
    covariance: Array


def area_landmarks(V: StochasticMap, features: Features, area: str, first: int) -> AreaLandmarks:
    """The landmarks of an area; ids count from `L<first>`."""
    walls = np.flatnonzero((features.kind == WALL) & (features.seen > 1))
    P = V.additive_covariance()
    which = np.concatenate(([0], 1 + walls))
    columns = (3 * which[:, None] + np.arange(3)).ravel()
    landmarks = []
    for i, w in enumerate(walls.tolist()):
        id_ = f"L{first + i}"
        X = V.poses[1 + w]
        J = np.zeros((3, 6))
        J_inverse = se2.compose_D_first(se2.invert(X), V.robot)
        J[:, 3:] = J_inverse @ se2.invert_D_pose(X)
        J[:, :3] = se2.compose_D_second(se2.invert(X), V.robot)
        c = np.r_[0:3, 3 * (1 + w) : 3 * (1 + w) + 3]
        C = symmetrise(J @ P[np.ix_(c, c)] @ J.T)
        joint = np.zeros((5, 5))
        joint[:3, :3] = C
        lo, hi = float(features.lo[w]), float(features.hi[w])
        segment = SegmentFeature(
            0.0, 0.0, 1, np.zeros((2, 2)), np.array([[lo, 0.0], [hi, 0.0]]), (True, True)
        )
        landmarks.append(
            LandmarkModel(
                id=id_,
                area=area,
                kind="wall",
                binds=("y", "theta"),
                robot=Estimate(id_, se2.between(X, V.robot), C),
                features=(segment,),
                covariance=joint,
                observations=int(features.seen[w]),
                utility=1.0,
            )
        )
    return AreaLandmarks(
        tuple(landmarks), V.poses[1 + walls], symmetrise(P[np.ix_(columns, columns)])
    )
