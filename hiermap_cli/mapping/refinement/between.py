"""Scans between key scans, each laid on the refined walls by itself.

What odometry says between two key scans is worth little while the robot turns, and nothing where
it misses a turn. The walls are known by now: a scan's own segments tell its pose, against what
odometry and the key scans at both sides have it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.refinement.matches import match_segments, placed
from hiermap_cli.mapping.refinement.problem import (
    Matched,
    segment_noise,
    stepped_poses,
    wall_terms,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import Config
    from hiermap_cli.estimation.noise import NoiseScale
    from hiermap_cli.mapping.keyscans import ScanSegments
    from hiermap_cli.mapping.refinement.problem import State

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

STEPS = 2
# What odometry may miss between two key scans, however little it tells.
UNSEEN = np.array([0.01, 0.01, 0.01])


def laid_on_walls(
    state: State,
    poses: Array,
    bridge: Array,
    segments: ScanSegments,
    noise: NoiseScale,
    config: Config,
) -> tuple[Array, Array]:
    """Poses (M, 3) of scans by their segments and by where they are thought to be.

    Args:
        state: the solution; its walls are taken as they are.
        poses: (M, 3) where the scans are thought to be.
        bridge: (M, 3, 3) covariance of that beside the key scans', in the robot's frame.
        segments: of these scans.
        noise: of the log.
        config: of the run.

    Returns:
        The poses, and what is then left of `bridge`.
    """
    prior = np.linalg.inv(bridge + np.diag(np.square(UNSEEN)))
    variances = segment_noise(segments, config.filter, noise)
    nothing = np.zeros(0, dtype=np.int64)
    X = poses
    information = prior
    for _ in range(STEPS):
        here = state._replace(poses=X)
        labels = match_segments(state.walls, placed(here, segments), segments, 1.0, config.refine)
        segment = np.flatnonzero(labels >= 0)
        matched = Matched(segment, labels[segment], nothing, nothing, nothing)
        terms = wall_terms(here, segments, variances, matched, config.refine.gate_wall)
        J = terms.J[:, :, :3]
        JW = J.transpose(0, 2, 1) @ terms.information
        information, g = prior.copy(), np.einsum("nij,nj->ni", prior, _off(poses, X))
        np.add.at(information, terms.scan, JW @ J)
        np.add.at(g, terms.scan, -np.einsum("nks,ns->nk", JW, terms.e))
        X = stepped_poses(X, np.linalg.solve(information, g[..., None])[..., 0])
    return X, np.asarray(np.linalg.inv(information))


def _off(poses: Array, X: Array) -> Array:
    """The step from X back to where it was thought to be, in X's frame."""
    return se2.log(se2.between(X, poses))
