"""Whether the covariances of the area frames tell the truth (`nees_areas`).

No reference knows where the model put an area's frame. But where landmarks of the area are matched
with true points, the frame that brings them nearest to these is the true one, up to what the
landmarks' own covariances leave open; that much is added to the frame's covariance.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.evaluation.consistency import Nees, nees_values
from hiermap_cli.evaluation.corners import CORNER_RADIUS, furniture_corners, wall_corners
from hiermap_cli.evaluation.matching import match_points
from hiermap_cli.evaluation.placed import is_corner, landmark_points, move_points
from hiermap_cli.geometry.se2 import compose, invert, rotation, wrap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.documents.reference import ReferenceMap
    from hiermap_cli.mapping.model import AreaModel, HierarchicalModel

    Array = NDArray[np.float64]

_LEAST = 3  # matched landmarks by which a frame is known
_WORST_HEADING = 0.1  # radians; a frame that is known no better tells nothing


def area_nees(
    model: HierarchicalModel, reference: ReferenceMap, R_t_g: Array, best_R_t_g: Array
) -> Nees:
    """Three degrees of freedom for every area with three matched corners or more.

    R_t_g (3,) from `first_pose_alignment`, by which errors are taken; best_R_t_g (3,) that of the
    best fit, by which corners are matched.
    """
    true = np.concatenate((wall_corners(reference).points, furniture_corners(reference)))
    corners = [landmark for landmark in model.landmarks if is_corner(landmark)]
    found = landmark_points(model, corners)
    pairs = match_points(move_points(best_R_t_g, found.points), true, CORNER_RADIUS)
    at = {found.ids[i]: true[j] for i, j in pairs.tolist()}
    frames = dict(model.environment.areas)
    ids, values = [], []
    for area in model.areas:
        fitted = _fitted(area, at, compose(best_R_t_g, frames[area.id].mean))
        if fitted is None:
            continue
        R_t_a, C_t_a = fitted
        R_g_t = invert(R_t_g)
        turn = np.eye(3)
        turn[:2, :2] = rotation(R_g_t[2])
        error = frames[area.id].mean - compose(R_g_t, R_t_a)
        error[2] = wrap(error[2])
        C = frames[area.id].covariance + turn @ C_t_a @ turn.T
        ids.append(area.id)
        values.append(float(nees_values(error[None], C[None])[0]))
    known = [value for value in values if not math.isnan(value)]
    mean = float(np.mean(known)) if known else math.nan
    # Frames are chained, so that their errors are not independent: one is counted for all.
    return Nees(mean, len(known), np.array(values), 1.0 if known else math.nan, tuple(ids))


def _fitted(area: AreaModel, at: dict[str, Array], start: Array) -> tuple[Array, Array] | None:
    """The frame R_t_a that brings an area's landmarks to true points, and its covariance."""
    chosen = [(estimate, at[id_]) for id_, estimate in area.landmarks if id_ in at]
    if len(chosen) < _LEAST:
        return None
    points = np.array([estimate.mean[:2] for estimate, _ in chosen])
    true = np.array([point for _, point in chosen])
    C = np.array([estimate.covariance[:2, :2] for estimate, _ in chosen])
    C = C + 1e-12 * np.eye(2)  # a landmark that is exactly known
    pose = start.copy()
    A = np.eye(3)
    for _ in range(10):
        turn = rotation(pose[2])
        moved = points @ turn.T
        J = np.zeros((len(points), 2, 3))
        J[:, 0, 0] = J[:, 1, 1] = 1.0
        J[:, 0, 2], J[:, 1, 2] = -moved[:, 1], moved[:, 0]
        W = np.linalg.inv(turn @ C @ turn.T)
        A = np.einsum("kia,kij,kjb->ab", J, W, J)
        b = np.einsum("kia,kij,kj->a", J, W, true - moved - pose[:2])
        step = np.linalg.solve(A, b)
        pose = pose + step
        if np.abs(step).max() < 1e-9:
            break
    C_pose = np.asarray(np.linalg.inv(A), dtype=float)
    return (pose, C_pose) if C_pose[2, 2] <= _WORST_HEADING**2 else None
