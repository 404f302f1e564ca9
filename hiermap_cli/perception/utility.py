"""What a landmark is worth: the uncertainty that it takes off the robot, as often as it is seen.

A robot that is uncertain by a known amount sees the landmark once more, as well as its walls are
seen, and knows by it the components that the landmark binds. What this takes off the entropy of
its pose is the worth of one sighting (section 2: "the improvement we can obtain on the accuracy
of the robot position"). How well the map knows the landmark is left out: the map's own error
wears off with the sightings, and where all of an area is uncertain its landmarks are no less
worth to the robot in their midst.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.perception.kinds.lineset import along_of
from hiermap_cli.perception.kinds.rules import POSE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import LandmarkConfig
    from hiermap_cli.perception.kinds.lineset import LineSet
    from hiermap_cli.perception.kinds.rules import Extraction, Group

    Array = NDArray[np.float64]


def worth(lines: LineSet, group: Group, found: Extraction, config: LandmarkConfig) -> float:
    """Nats that one sighting takes off the entropy of the robot's pose."""
    C = np.zeros((4 * len(group.lines), 4 * len(group.lines)))
    for slot, line in enumerate(group.lines):
        C[4 * slot : 4 * slot + 4, 4 * slot : 4 * slot + 4] = _sighting(lines, line, config)
    turn = np.eye(3)
    turn[:2, :2] = se2.rotation(-found.pose[2])
    J = turn @ found.pose_D_lines
    bound = [POSE.index(name) for name in found.binds]
    R = (J @ C @ J.T)[np.ix_(bound, bound)]
    prior = np.diag([config.prior_sigma, config.prior_sigma, config.prior_sigma_theta])[bound] ** 2
    gain = np.eye(len(bound)) + np.linalg.solve(R, prior[:, bound])
    return float(0.5 * np.linalg.slogdet(gain)[1])


def utility(lines: LineSet, group: Group, found: Extraction, config: LandmarkConfig) -> float:
    """The worth of one sighting times the sightings."""
    return worth(lines, group, found, config) * sightings(lines, group)


def sightings(lines: LineSet, group: Group) -> int:
    """How often the landmark was seen: as often as the least seen of its lines."""
    return int(lines.seen[list(group.lines)].min())


def _sighting(lines: LineSet, line: int, config: LandmarkConfig) -> Array:
    """Covariance (4, 4) with which a line's parameters are measured when it is seen again."""
    sigma = config.sighting_sigma
    var_alpha = config.sighting_sigma_theta**2 + (sigma / max(float(lines.length[line]), 0.1)) ** 2
    S = lines.hesse[line]
    lever = float(along_of(S, lines.ends[line].mean(axis=0)))
    J = np.eye(4)
    J[1, 0] = lever
    J[2:, 0] = -S[1]
    return np.asarray(J @ np.diag([var_alpha, sigma**2, sigma**2, sigma**2]) @ J.T)
