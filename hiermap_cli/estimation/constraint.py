"""Equation 3: what is seen again constrains V.

Rows of a measurement are linearised (`jacobian`), their innovations' covariance is predicted
(`predicted`), and those that are believed are added (`constrain`). Only relative poses are
measured, so that a row touches the robot, the parameters and one object: `H P` needs no more
rows of P than these, however large V is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from hiermap_cli.estimation.gaussian import (
    Correction,
    Gain,
    condition,
    gain,
    robot_correction,
)
from hiermap_cli.estimation.stochastic_map import StochasticMap, corrected
from hiermap_cli.geometry import se2

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

Update = Literal["relocation_fusion", "ekf"]


class Rows(NamedTuple):
    """A measurement linearised in the invariant error: k rows over some poses of the map.

    innovation: (k,). pose: (k,) the object measured by each row (index into `poses`).
    H_object: (k, 3) d row / d delta of that object; the robot's is minus that, since only
    relative poses are measured. H_parameters: (k, m).
    """

    innovation: Array
    pose: Index
    H_object: Array
    H_parameters: Array


class Jacobian(NamedTuple):
    """H of rows in a map's own coordinates, by its parts that are not zero.

    common: (k, 3 + m) over the robot and the parameters. own: (k, 3) over the object that each
    row measures, `pose` (k,).
    """

    common: Array
    own: Array
    pose: Index

    def times(self, V: StochasticMap) -> tuple[Array, Array]:
        """`H P` (k, N) and `H P H^T` (k, k)."""
        P, start, n = V.covariance, V.first_object, V.objects
        object_ = self.pose - 1
        HP = self.common @ P[:start]
        P_own = P[start:].reshape(n, 3, len(P)).take(object_, axis=0)
        HP += np.matmul(self.own[:, None], P_own)[:, 0]
        HPH = HP[:, :start] @ self.common.T
        HP_own = HP[:, start:].reshape(len(HP), n, 3).take(object_, axis=1)
        HPH += np.matmul(HP_own.transpose(1, 0, 2), self.own[:, :, None])[:, :, 0].T
        return HP, HPH


def jacobian(V: StochasticMap, rows: Rows) -> Jacobian:
    """H of the rows at V."""
    common = np.empty((len(rows.innovation), V.first_object))
    own = rows.H_object
    np.negative(own, out=common[:, :3])
    common[:, 3:] = rows.H_parameters
    if V.coordinates == "additive":
        own = np.einsum("ki,kij->kj", own, se2.invariant_D_additive(V.poses[rows.pose]))
        common[:, :3] = common[:, :3] @ se2.invariant_D_additive(V.robot)
    return Jacobian(common, own, rows.pose)


class Prediction(NamedTuple):
    """What rows are predicted to be before they are believed.

    innovation: (k,). H_robot: (k, 3) over the robot. HP: (k, N). S: (k, k) the innovations'
    covariance.
    """

    innovation: Array
    H_robot: Array
    HP: Array
    S: Array

    def constraint(self, rows: Index) -> Constraint:
        """Some of the rows, ready to be added to V."""
        return Constraint(
            self.innovation.take(rows),
            self.H_robot.take(rows, axis=0),
            gain(self.HP.take(rows, axis=0), self.S.take(rows, axis=0).take(rows, axis=1)),
        )


class Constraint(NamedTuple):
    """Rows ready to be added to V: innovation (k,), H over the robot (k, 3), what they would do."""

    innovation: Array
    H_robot: Array
    gain: Gain


def predicted(V: StochasticMap, rows: Rows, R: Array) -> Prediction:
    """The rows linearised at V with their noise R (k, k)."""
    H = jacobian(V, rows)
    HP, S = H.times(V)
    S += R
    return Prediction(rows.innovation, H.common[:, :3], HP, S)


def prepare(V: StochasticMap, rows: Rows, R: Array) -> Constraint:
    """A constraint of all rows, with their noise R (k, k)."""
    told = predicted(V, rows, R)
    return Constraint(told.innovation, told.H_robot, gain(told.HP, told.S))


def constrain(
    V: StochasticMap,
    constraint: Constraint,
    measure: Callable[[StochasticMap], Array],
    update: Update = "relocation_fusion",
) -> tuple[StochasticMap, Correction]:
    """Equation 3: objects seen again. Returns V after it, and the correction that was made.

    `measure` gives the innovations (k,) of the same rows predicted from another V. With
    `relocation_fusion` (Moutarlier and Chatila) the robot is first corrected alone, from all
    rows; then everything is corrected, with the rows predicted at the relocated robot. The
    second step starts from the state **before** the first, with the innovation
    `y(V') + H (V' - V)`: the rows enter once, and on a linear model the result is the Kalman
    filter's to the digit. (Carrying the relocated state and its correlation with the noise into
    the second step is the same on paper, but its innovation covariance is nearly singular: see
    docs/design.md.) H is kept: in invariant coordinates it does not depend on the robot, and
    where it does a Jacobian that changes between two steps counts as information.
    """
    innovation = constraint.innovation
    if update == "relocation_fusion":
        relocation = robot_correction(constraint.gain, innovation)
        relocated = _relocated(V, relocation)
        innovation = measure(relocated) + constraint.H_robot @ relocation
    made = condition(V.covariance, constraint.gain, innovation)
    return corrected(V, made.delta, made.covariance), made


def _relocated(V: StochasticMap, delta_r: Array) -> StochasticMap:
    """V with the robot's mean alone moved."""
    poses = V.poses.copy()
    if V.coordinates == "invariant":
        poses[0] = se2.compose(se2.exp(delta_r), V.robot)
    else:
        poses[0] = V.robot + delta_r
        poses[0, 2] = se2.wrap_one(float(poses[0, 2]))
    return StochasticMap(poses, V.parameters, V.covariance, V.coordinates)
