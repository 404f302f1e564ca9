"""The stochastic map of section 3: a state vector V of robot and objects, and C(V).

V = (robot R_k_r, calibration parameters, object poses R_k_i) in one frame k. The error of V is
a vector of dimension N = 3 + m + 3 n in this order. In *invariant* coordinates a pose's error
is `delta = log(X X_hat^-1)`, global and left-multiplied: a change of frame moves all errors
alike, whatever the estimate, which is what keeps the filter consistent (Bailey 2006, Huang et
al. 2010). In *additive* ones it is that of (x, y, theta), as the paper has it. All Jacobians are
written for the invariant error; additive ones follow by `invariant_D_additive`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from hiermap_cli.estimation.gaussian import symmetrise
from hiermap_cli.geometry import se2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

Coordinates = Literal["invariant", "additive"]


class StochasticMap(NamedTuple):
    """V and C(V). poses: (1 + n, 3), the robot first; parameters: (m,); covariance: (N, N)."""

    poses: Array
    parameters: Array
    covariance: Array
    coordinates: Coordinates = "invariant"

    @property
    def robot(self) -> Array:
        """The robot's pose, (3,)."""
        return np.asarray(self.poses[0])

    @property
    def objects(self) -> int:
        """The number n of objects."""
        return len(self.poses) - 1

    @property
    def first_object(self) -> int:
        """Index of the first object's error in the state: 3 + m."""
        return 3 + len(self.parameters)

    def columns(self, i: int) -> slice:
        """The components of V that belong to pose i: 0 is the robot, 1 the first object."""
        start = 0 if i == 0 else self.first_object + 3 * (i - 1)
        return slice(start, start + 3)

    def error_columns(self, objects: Index) -> Index:
        """The components of V of robot, parameters, and objects (k,) from 0: (3 + m + 3 k,)."""
        start = self.first_object
        own = start + (3 * np.asarray(objects)[:, None] + np.arange(3)).ravel()
        return np.concatenate((np.arange(start), own))

    def pose_covariance(self, i: int) -> Array:
        """Additive covariance (3, 3) of pose i."""
        where = self.columns(i)
        J = self.additive_D_error(self.poses[i])
        return np.asarray(J @ self.covariance[where, where] @ J.T)

    def additive_D_error(self, pose: Array) -> Array:
        """d (x, y, theta) / d error of a pose, in this map's coordinates, (..., 3, 3)."""
        if self.coordinates == "invariant":
            return se2.additive_D_invariant(pose)
        return _ones_like(pose)

    def invariant_D_error(self, pose: Array) -> Array:
        """d delta / d error of a pose, in this map's coordinates, (..., 3, 3)."""
        if self.coordinates == "invariant":
            return _ones_like(pose)
        return se2.invariant_D_additive(pose)

    def by_error(self, J: Array, pose: Array) -> Array:
        """A Jacobian (..., 3, 3) by deltas as one by the errors of poses (..., 3)."""
        return J if self.coordinates == "invariant" else J @ se2.invariant_D_additive(pose)

    def error_D_tangent(self, pose: Array) -> Array:
        """d error / d tangent at a pose (its own frame), in this map's coordinates, (3, 3)."""
        Ad = se2.adjoint(pose)
        if self.coordinates == "invariant":
            return Ad
        return np.asarray(se2.additive_D_invariant(pose) @ Ad)


_ONE = np.eye(3)
_ONE.flags.writeable = False


def _ones_like(pose: Array) -> Array:
    """An identity matrix for each pose (..., 3): (..., 3, 3), not to be written to."""
    return _ONE if pose.ndim == 1 else np.broadcast_to(_ONE, (*pose.shape, 3))


class Motion(NamedTuple):
    """A relative motion Delta_{i,i+1} (figure 2-a), with its noise and calibration Jacobian.

    pose: (3,) the increment R_i_{i+1}. covariance: (3, 3) of its error, in the robot's frame
    **after** the motion. by_parameters: (3, m) d error / d parameters, in the same frame.
    """

    pose: Array
    covariance: Array
    by_parameters: Array


def initial_map(
    robot: Array,
    C_robot: Array,
    parameters: Array,
    C_parameters: Array,
    coordinates: Coordinates = "invariant",
) -> StochasticMap:
    """A map without objects; `C_robot` is additive, (3, 3)."""
    m = len(parameters)
    P = np.zeros((3 + m, 3 + m))
    J = np.eye(3) if coordinates == "additive" else se2.invariant_D_additive(robot)
    P[:3, :3] = J @ C_robot @ J.T
    P[3:, 3:] = C_parameters
    return StochasticMap(np.array(robot, dtype=float)[None], parameters, P, coordinates)


def predict(V: StochasticMap, motion: Motion) -> StochasticMap:
    """Equation 1: `R_k_r <- f(R_k_r, Delta)` with the cross-covariances of section 3.1.

    In invariant coordinates J1 is the identity: motion moves the robot's block alone, by
    `Ad(X_r) (J_c e_c + w)` with X_r after the motion.
    """
    X = se2.compose(V.robot, motion.pose)
    poses = V.poses.copy()
    poses[0] = X
    P = V.covariance.copy()
    Ad = se2.adjoint(X)
    rows, J1 = P[:3], None
    if V.coordinates == "additive":
        Ad = se2.additive_D_invariant(X) @ Ad
        J1 = se2.compose_D_first(V.robot, motion.pose)
        rows = J1 @ rows
    # F P F^T with F = [J1 G] over robot and parameters: its rows, then the robot's corner.
    start = V.first_object
    G = Ad @ motion.by_parameters
    rows = rows + G @ P[3:start]
    corner = rows[:, :3] if J1 is None else rows[:, :3] @ J1.T
    corner = corner + rows[:, 3:start] @ G.T + Ad @ motion.covariance @ Ad.T
    P[:3], P[:, :3] = rows, rows.T
    P[:3, :3] = symmetrise(corner)
    return StochasticMap(poses, V.parameters, P, V.coordinates)


def add_objects(
    V: StochasticMap, R_r_l: Array, C_tangent: Array, by_parameters: Array | None = None
) -> StochasticMap:
    """Equation 2: objects seen from the robot enter V, correlated with all that the robot is.

    R_r_l: (k, 3). C_tangent: (k, 3, 3) noise in the tangent at R_r_l (the object's own frame).
    by_parameters: (k, 3, m) d (error in the object's frame) / d parameters.
    """
    X = se2.compose(V.robot, R_r_l)
    k, start = len(X), V.first_object
    Ad = se2.adjoint(X)
    A = np.zeros((k, 3, start))
    A[:, :, :3] = V.invariant_D_error(V.robot)
    if by_parameters is not None:
        A[:, :, 3:] = Ad @ by_parameters
    noise = Ad @ C_tangent @ Ad.transpose(0, 2, 1)
    return augment(V, X, np.arange(start), A, noise)


def augment(V: StochasticMap, X: Array, columns: Index, A: Array, noise: Array) -> StochasticMap:
    """Objects X (k, 3) with invariant errors `A e + w`.

    A: (k, 3, c) over `columns` (c,) of V; w: independent, of blocks (k, 3, 3).
    """
    k, N = len(X), len(V.covariance)
    if V.coordinates == "additive":
        T = se2.additive_D_invariant(X)
        A = T @ A
        noise = T @ noise @ T.transpose(0, 2, 1)
    A = A.reshape(3 * k, len(columns))
    P = np.empty((N + 3 * k, N + 3 * k))
    P[:N, :N] = V.covariance
    AP = A @ V.covariance.take(columns, axis=0)
    P[N:, :N] = AP
    P[:N, N:] = AP.T
    corner = AP.take(columns, axis=1) @ A.T
    for i in range(k):
        corner[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += noise[i]
    P[N:, N:] = symmetrise(corner)
    return StochasticMap(np.concatenate((V.poses, X)), V.parameters, P, V.coordinates)


def remove_objects(V: StochasticMap, keep: Index) -> StochasticMap:
    """V with only the objects of the given pose indices (1 .. n), in that order."""
    columns = V.error_columns(np.asarray(keep) - 1)
    return V._replace(
        poses=V.poses[np.concatenate(([0], keep)).astype(np.int64)],
        covariance=V.covariance.take(columns, axis=0).take(columns, axis=1),
    )


def corrected(V: StochasticMap, delta: Array, P: Array) -> StochasticMap:
    """V with its means moved by `delta` (N,) and the covariance P."""
    m = len(V.parameters)
    steps = np.concatenate((delta[:3], delta[3 + m :])).reshape(-1, 3)
    if V.coordinates == "invariant":
        poses = se2.moved(V.poses, steps)
    else:
        poses = V.poses + steps
        poses[:, 2] = se2.wrap(poses[:, 2])
    return StochasticMap(poses, V.parameters + delta[3 : 3 + m], P, V.coordinates)


def relative_covariance(V: StochasticMap, i: int, j: int) -> Array:
    """Covariance (3, 3) of pose j seen from pose i, in the tangent at i (0 is the robot)."""
    a, b = V.columns(i), V.columns(j)
    T_a, T_b = V.invariant_D_error(V.poses[i]), V.invariant_D_error(V.poses[j])
    P = V.covariance
    cross = T_b @ P[b, a] @ T_a.T
    C = T_a @ P[a, a] @ T_a.T + T_b @ P[b, b] @ T_b.T - cross - cross.T
    Ad = se2.adjoint(se2.invert(V.poses[i]))
    return symmetrise(Ad @ C @ Ad.T)


def place_robot(
    V: StochasticMap, i: int, R_i_r: Array, C_tangent: Array, parameters: Array, C_parameters: Array
) -> StochasticMap:
    """V with the robot put anew at `compose(X_i, R_i_r)`, relative to object i.

    C_tangent: (3, 3) of R_i_r in the tangent at i, independent of V. The parameters are replaced
    too; what they had in common with the objects of V is dropped, which keeps every marginal.
    """
    robot = se2.compose(V.poses[i], R_i_r)
    m, N, where = len(parameters), len(V.covariance), V.columns(i)
    T = se2.additive_D_invariant if V.coordinates == "additive" else _identity
    to_robot = T(robot) @ V.invariant_D_error(V.poses[i])
    Ad = T(robot) @ se2.adjoint(V.poses[i])
    P = V.covariance.copy()
    P[3 : 3 + m], P[:, 3 : 3 + m] = 0.0, 0.0
    P[3 : 3 + m, 3 : 3 + m] = C_parameters
    row = to_robot @ P[where]
    P[:3, 3 + m : N], P[3 + m : N, :3] = row[:, 3 + m :], row[:, 3 + m :].T
    P[:3, 3 : 3 + m], P[3 : 3 + m, :3] = 0.0, 0.0
    P[:3, :3] = to_robot @ P[where, where] @ to_robot.T + Ad @ C_tangent @ Ad.T
    poses = V.poses.copy()
    poses[0] = robot
    return V._replace(poses=poses, parameters=parameters, covariance=P)


def _identity(_pose: Array) -> Array:
    return np.eye(3)


def clone_robot(V: StochasticMap) -> StochasticMap:
    """V with a copy of the robot's present pose as a new object, fully correlated with it."""
    A = V.invariant_D_error(V.robot)[None]
    return augment(V, V.robot[None], np.arange(3), A, np.zeros((1, 3, 3)))


def seen_from_robot(V: StochasticMap, keep: Index) -> StochasticMap:
    """A map in the robot's own frame.

    The robot certain at the origin, the parameters, and the objects of the given pose indices with
    the errors of their poses relative to the robot.

    `X' = X_r^-1 X_l`, so `delta' = Ad(X_r^-1) (delta_l - delta_r)`.
    """
    m, k, N = len(V.parameters), len(keep), len(V.covariance)
    poses = np.concatenate((np.zeros((1, 3)), se2.between(V.robot, V.poses[keep])))
    Ad = se2.adjoint(se2.invert(V.robot))
    T = np.zeros((3 + m + 3 * k, N))
    T[3 : 3 + m, 3 : 3 + m] = np.eye(m)
    for i, pose in enumerate(keep.tolist()):
        rows = slice(3 + m + 3 * i, 6 + m + 3 * i)
        here = Ad if V.coordinates == "invariant" else se2.additive_D_invariant(poses[1 + i]) @ Ad
        T[rows, V.columns(pose)] = here @ V.invariant_D_error(V.poses[pose])
        T[rows, :3] = -here @ V.invariant_D_error(V.robot)
    return V._replace(poses=poses, covariance=symmetrise(T @ V.covariance @ T.T))
