"""The robot's estimate handed from one area to the next, with the calibration of its odometry.

Areas share no errors but through their anchors. What the robot takes along is what has been learnt
of its odometry; where it is in the other area comes from anchors, from walls, or from nowhere.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.estimation.stochastic_map import (
    StochasticMap,
    initial_map,
    place_robot,
    relative_covariance,
)
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import EMPTY, AreaMap
from hiermap_cli.mapping.association.relocation import robot_found
from hiermap_cli.mapping.portals import anchor_index

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import RelocationConfig

    Array = NDArray[np.float64]


def of_parameters(V: StochasticMap) -> Array:
    """Covariance (m, m) of the odometry's parameters."""
    m = len(V.parameters)
    return V.covariance[3 : 3 + m, 3 : 3 + m]


def begun_anew(V: StochasticMap) -> AreaMap:
    """An empty area, in whose frame the robot is certain at the origin."""
    known = of_parameters(V)
    nowhere, surely = np.zeros(3), np.zeros((3, 3))
    return AreaMap(initial_map(nowhere, surely, V.parameters, known, V.coordinates), EMPTY)


def by_anchors(left: AreaMap, out: int, entered: AreaMap, into: int) -> AreaMap:
    """The area entered, with the robot as far from its anchor `into` as from `out` in that left.

    Both anchors, by their uid, are one place. What the robot did since it was there is in the area
    left, and independent of the other.
    """
    V = left.V
    i, j = anchor_index(left, out), anchor_index(entered, into)
    R_anchor_r, C = se2.between(V.poses[i], V.robot), relative_covariance(V, i, 0)
    placed = place_robot(entered.V, j, R_anchor_r, C, V.parameters, of_parameters(V))
    return entered._replace(V=placed)


def by_walls(V: StochasticMap, R_h_c: Array, known: AreaMap, config: RelocationConfig) -> AreaMap:
    """The area that is known again, with the robot where the walls show it.

    It is as uncertain as such a pose is. R_h_c: (3,) the frame of V seen from that area's.
    """
    found = robot_found(known.V, se2.compose(R_h_c, V.robot), config)
    m, P = len(V.parameters), found.covariance.copy()
    P[3 : 3 + m], P[:, 3 : 3 + m] = 0.0, 0.0
    P[3 : 3 + m, 3 : 3 + m] = of_parameters(V)
    return known._replace(V=found._replace(parameters=V.parameters, covariance=P))
