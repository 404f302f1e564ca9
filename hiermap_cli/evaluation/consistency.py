"""Whether a covariance tells the truth: normalised estimation error squared (NEES).

A NEES per degree of freedom of 1 is what an honest covariance gives; above it the estimator is
overconfident, below it too timid. Estimate and truth are put together at the first common pose,
never by best fit, which would hide the drift that the covariance has to cover.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.evaluation.bands import independent_of_groups, independent_of_sequence
from hiermap_cli.evaluation.corners import CORNER_RADIUS, furniture_corners, wall_corners
from hiermap_cli.evaluation.doors import DOOR_RADIUS
from hiermap_cli.evaluation.matching import match_points
from hiermap_cli.evaluation.placed import is_corner, is_door, landmark_points, move_points
from hiermap_cli.evaluation.trajectory import MAX_GAP_S, PosesAt, poses_at
from hiermap_cli.geometry.se2 import compose, invert, wrap
from hiermap_cli.mapping.model import Metric

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.documents.reference import ReferenceDoor, ReferenceMap
    from hiermap_cli.evaluation.placed import PlacedPoints
    from hiermap_cli.mapping.model import HierarchicalModel, Trajectory

    Array = NDArray[np.float64]
    Pairs = NDArray[np.int64]
    Stamps = NDArray[np.int64]

_SINGULAR = 1e-10  # smallest eigenvalue of a correlation matrix that is still inverted
_ROUNDING_NS = 1_000_000  # stamps written with three decimals are still the same
_THICKEST = 0.5  # metres from a door's line to a face of its wall


class DoorFace(NamedTuple):
    """Where a door's landmark can truly be, (2,), and the way out of the area that sees it there.

    out: (2,) unit vector from the free side of the face into the wall; zero where the sides are
    not told apart.
    """

    point: Array
    out: Array


class Nees(NamedTuple):
    """The mean NEES per degree of freedom, nan where `n` is 0, and the single values.

    values: (k,) per pose or landmark, nan where the covariance is singular or nothing matches.
    independent: how many values are as good as independent. ids: of the landmarks or areas.
    """

    mean: float
    n: int
    values: Array
    independent: float = math.nan
    ids: tuple[str, ...] = ()

    def metrics(self, name: str) -> tuple[Metric, ...]:
        """The figure under its name in eval.json; nothing where it was not measured."""
        return () if self.n == 0 else (Metric(name, "1", self.mean, self.n),)


def whitened(errors: Array, covariances: Array) -> tuple[Array, NDArray[np.bool_]]:
    """`L^-1 e` with `C = L L'` of those errors (N, d) whose covariance is regular, and which."""
    usable = ~np.isnan(nees_values(errors, covariances))
    L = np.linalg.cholesky(covariances[usable])
    return np.linalg.solve(L, errors[usable][:, :, None])[:, :, 0], usable


def nees_values(errors: Array, covariances: Array) -> Array:
    """`e' C^-1 e / d` for errors (N, d) and covariances (N, d, d); nan where C is singular."""
    sigma = np.sqrt(np.maximum(np.einsum("nii->ni", covariances), 0.0))
    usable = (sigma > 0.0).all(axis=1)
    scale = np.where(sigma > 0.0, sigma, 1.0)
    correlation = covariances / (scale[:, :, None] * scale[:, None, :])
    usable &= np.linalg.eigvalsh(correlation)[:, 0] > _SINGULAR
    values = np.full(len(errors), math.nan)
    whitened = errors[usable] / scale[usable]
    solved = np.linalg.solve(correlation[usable], whitened[:, :, None])[:, :, 0]
    values[usable] = (whitened * solved).sum(axis=1) / errors.shape[1]
    return values


def first_pose_alignment(
    stamps_ns: Stamps, poses: Array, truth_ns: Stamps, truth: Array
) -> Array | None:
    """`R_t_g` (3,) that puts estimate (N, 3) and truth (T, 3) together at the first common pose.

    That is the first estimated pose whose time the truth covers; None where there is none.
    """
    at, found = _truth_at(truth_ns, truth, stamps_ns)
    if not found.any():
        return None
    first = int(np.argmax(found))
    return compose(at[first], invert(poses[first]))


def _truth_at(truth_ns: Stamps, truth: Array, stamps_ns: Stamps) -> PosesAt:
    """The truth interpolated at stamps (N,), and where it has a pose within 0.5 s.

    Never beyond its ends: the robot's way there would count as an error of the estimate.
    """
    at, found = poses_at(truth_ns, truth, stamps_ns, MAX_GAP_S)
    if len(truth_ns):
        first, last = np.min(truth_ns) - _ROUNDING_NS, np.max(truth_ns) + _ROUNDING_NS
        found = found & (stamps_ns >= first) & (stamps_ns <= last)
    return PosesAt(at, found)


def robot_nees(trajectory: Trajectory, truth_ns: Stamps, truth: Array) -> Nees:
    """`nees_robot`: three degrees of freedom, the additive error of every scan's pose in g.

    truth_ns (T,), truth (T, 3) are the true robot poses in any frame.
    """
    values = np.full(len(trajectory.poses), math.nan)
    R_t_g = first_pose_alignment(trajectory.stamps_ns, trajectory.poses, truth_ns, truth)
    if R_t_g is not None:
        at, found = _truth_at(truth_ns, truth, trajectory.stamps_ns)
        errors = trajectory.poses - compose(invert(R_t_g), at)
        errors[:, 2] = wrap(errors[:, 2])
        values[found] = nees_values(errors[found], trajectory.covariances[found])
        white, _ = whitened(errors[found], trajectory.covariances[found])
        return _mean(values)._replace(independent=independent_of_sequence(white))
    return _mean(values)


def landmark_nees(
    model: HierarchicalModel, reference: ReferenceMap, R_t_g: Array, best_R_t_g: Array
) -> Nees:
    """`nees_landmarks`: two degrees of freedom, positions in g of matched corners and doors.

    Args:
        model: the map.
        reference: what is truly there, in frame t.
        R_t_g: (3,) from `first_pose_alignment`, by which the errors are taken.
        best_R_t_g: (3,) from the best fit of the trajectories, by which landmarks are matched,
            as for `corner_*` and `door_*`.
    """
    corners = np.concatenate((wall_corners(reference).points, furniture_corners(reference)))
    faces = [face for door in reference.doors or () for face in door_faces(door, reference)]
    doors = np.array([face.point for face in faces]).reshape(-1, 2)
    found = [landmark_points(model, filter(is_a, model.landmarks)) for is_a in (is_corner, is_door)]
    placed = [points.moved(best_R_t_g) for points in found]
    matches = (
        (corners, match_points(placed[0].points, corners, CORNER_RADIUS)),
        (doors, match_points(placed[1].points, doors, DOOR_RADIUS, _same_side(placed[1], faces))),
    )
    values = np.concatenate(
        [_point_nees(one, *match, R_t_g) for one, match in zip(found, matches, strict=True)]
    )
    ids = tuple(id_ for points in found for id_ in points.ids)
    return _mean(values)._replace(independent=_independent(model, ids, values), ids=ids)


def _independent(model: HierarchicalModel, ids: tuple[str, ...], values: Array) -> float:
    """How many landmarks' values are independent: those of one area share its frame's error."""
    frames = {area: one.covariance for area, one in model.environment.areas}
    homes = {landmark.id: landmark.area for landmark in model.landmarks}
    chosen = set(ids)
    points = landmark_points(model, (one for one in model.landmarks if one.id in chosen))
    variance = dict(zip(points.ids, np.trace(points.covariances, axis1=1, axis2=2), strict=True))
    groups: dict[str, list[float]] = {}
    for id_, value in zip(ids, values, strict=True):
        if math.isnan(value):
            continue
        of_frame = float(np.trace(frames[homes[id_]][:2, :2]))
        groups.setdefault(homes[id_], []).append(min(of_frame / float(variance[id_]), 1.0))
    return independent_of_groups([np.array(group) for group in groups.values()])


def _same_side(doors: PlacedPoints, faces: Sequence[DoorFace]) -> NDArray[np.bool_]:
    """Which of the faces (m) the area of each door landmark (k) sees, (k, m).

    The Y axis of a door landmark points out of its area, so into the wall on its side.
    """
    Y = np.column_stack((-np.sin(doors.headings), np.cos(doors.headings)))
    out = np.array([face.out for face in faces]).reshape(-1, 2)
    return np.asarray(Y @ out.T >= 0.0)


def _point_nees(found: PlacedPoints, true: Array, pairs: Pairs, R_t_g: Array) -> Array:
    """NEES (k,) of landmarks in g, paired with true points (m, 2) in t; nan where none is."""
    values = np.full(len(found.ids), math.nan)
    i, j = pairs.T
    errors = found.points[i] - move_points(invert(R_t_g), true[j])
    values[i] = nees_values(errors, found.covariances[i])
    return values


def door_faces(door: ReferenceDoor, reference: ReferenceMap) -> list[DoorFace]:
    """Where a door's landmark can truly be: the middle between the jambs on each face of its wall.

    A door landmark lies on the face that its area sees. The faces are found from ends of walls
    beside both jambs at the same distance from the door's line; without such walls it is the
    door's line itself. A face seen alone, and the door's line, have no sides.
    """
    middle, span = 0.5 * (door.p1 + door.p2), door.p2 - door.p1
    width = float(np.hypot(*span))
    if reference.walls is None or width == 0.0:
        return [DoorFace(middle, np.zeros(2))]
    along = span / width
    normal = np.array([-along[1], along[0]])
    ends = reference.walls.reshape(-1, 2) - middle
    u, v = ends @ along, ends @ normal
    beside = (np.abs(np.abs(u) - 0.5 * width) < 0.02) & (np.abs(v) < _THICKEST)
    left, right = v[beside & (u < 0)], v[beside & (u > 0)]
    faces: list[float] = []
    for offset in np.sort(left).tolist():
        repeated = any(abs(offset - face) < 0.02 for face in faces)
        if not repeated and (np.abs(right - offset) < 0.02).any():
            faces.append(offset)
    if len(faces) < 2:
        return [DoorFace(middle + offset * normal, np.zeros(2)) for offset in faces or [0.0]]
    within = 0.5 * (faces[0] + faces[-1])  # the free sides are away from it
    return [
        DoorFace(middle + offset * normal, normal if offset < within else -normal)
        for offset in faces
    ]


def position_sigmas(covariances: Array) -> Array:
    """Deviation (N,) of the position over both axes, the root of the trace, of (N, 3, 3)."""
    trace = covariances[:, 0, 0] + covariances[:, 1, 1]
    return np.asarray(np.sqrt(np.maximum(trace, 0.0)), dtype=np.float64)


def _mean(values: Array) -> Nees:
    known = values[~np.isnan(values)]
    return Nees(float(known.mean()) if len(known) else math.nan, len(known), values)
