"""What the tests of the estimator share: maps, derivatives on the manifold, exact views."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import block_diag

from hiermap_cli.estimation.constraint import Rows, jacobian
from hiermap_cli.estimation.gaussian import Gain, gain
from hiermap_cli.estimation.stochastic_map import StochasticMap, corrected
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import END, WALL, AreaMap, Features
from hiermap_cli.mapping.assembly import assemble
from hiermap_cli.mapping.levels import compose_levels
from hiermap_cli.perception.segments import END_OPEN, END_VERTEX
from hiermap_cli.perception.views import SegmentView

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from hiermap_cli.mapping.mapper import Mapper
    from hiermap_cli.mapping.model import MapResult

    Array = NDArray[np.float64]

COORDINATES = ("invariant", "additive")
UPDATES = ("relocation_fusion", "ekf")
STEP = 1e-5


def assembled(mapper: Mapper) -> MapResult:
    """The result of the filter alone, as with `--no-refine`."""
    levels = compose_levels(mapper)
    return assemble(mapper, levels, levels)


def random_covariance(rng: np.random.Generator, n: int, sigma: float = 0.05) -> Array:
    """Positive definite (n, n), with correlations."""
    A = rng.normal(size=(n, n + 2)) / np.sqrt(n + 2)
    return sigma**2 * (A @ A.T + 0.05 * np.eye(n))


def random_pose(rng: np.random.Generator, size: float = 4.0) -> Array:
    return np.array([*rng.uniform(-size, size, 2), rng.uniform(-np.pi, np.pi)])


def random_map(
    rng: np.random.Generator,
    objects: int,
    coordinates: str = "invariant",
    parameters: int = 4,
    sigma: float = 0.05,
) -> StochasticMap:
    """A map with poses about the origin and a full covariance."""
    poses = np.array([random_pose(rng) for _ in range(1 + objects)])
    P = random_covariance(rng, 3 + parameters + 3 * objects, sigma)
    return StochasticMap(poses, 0.05 * rng.normal(size=parameters), P, coordinates)


def moved(V: StochasticMap, e: Array) -> StochasticMap:
    """V with its means moved by the error `e` (N,), in its own coordinates."""
    return corrected(V, e, V.covariance)


def gain_of(P: Array, columns: Array, H_c: Array, R: Array) -> Gain:
    """The gain of rows that are H_c over some columns of P (named twice they add up)."""
    H = np.zeros((len(H_c), len(P)))
    np.add.at(H, (slice(None), columns), H_c)
    return gain(H @ P, H @ P @ H.T + R)


def whole_jacobian(V: StochasticMap, rows: Rows) -> Array:
    """H (k, N) of rows."""
    H = jacobian(V, rows)
    whole = np.zeros((len(H.own), len(V.covariance)))
    whole[:, : V.first_object] = H.common
    for k, pose in enumerate(H.pose):
        whole[k, V.columns(int(pose))] = H.own[k]
    return whole


def error_of(coordinates: str, pose: Array, estimate: Array) -> Array:
    """The error (3,) of an estimated pose, in the given coordinates."""
    if coordinates == "invariant":
        return se2.log(se2.compose(pose, se2.invert(estimate)))
    e = pose - estimate
    e[2] = se2.wrap(e[2])
    return e


def derivative(function: Callable[[Array], Array], size: int, step: float = STEP) -> Array:
    """Central differences of `function` at zero: (len(function), size)."""
    columns = []
    for k in range(size):
        e = np.zeros(size)
        e[k] = step
        columns.append((np.asarray(function(e)) - np.asarray(function(-e))) / (2.0 * step))
    return np.stack(columns, axis=-1)


def walls_area(
    V: StochasticMap,
    half: Sequence[float],
    ends: Sequence[tuple[int, int]] = (),
    seen: int = 5,
) -> AreaMap:
    """An area of V: its first objects are walls with these half lengths, the rest are ends.

    ends: (wall, side) of each, in order.
    """
    walls, n = len(half), len(half) + len(ends)
    assert V.objects == n
    reach = np.array([*half, *(0.0 for _ in ends)])
    return AreaMap(
        V,
        Features(
            uid=np.arange(n),
            kind=np.array([WALL] * walls + [END] * len(ends)),
            wall=np.array([-1] * walls + [wall for wall, _ in ends]),
            side=np.array([0] * walls + [side for _, side in ends]),
            lo=-reach,
            hi=reach.copy(),
            seen=np.full(n, seen),
            last=np.zeros(n, dtype=np.int64),
        ),
        n,
    )


def view_from(
    area: AreaMap,
    parts: Sequence[tuple[int, float, float]],
    kinds: Sequence[tuple[int, int]] | None = None,
    sigma: float = 0.01,
    sigma_theta: float = 0.005,
) -> SegmentView:
    """What a scan sees, without error, of an area's walls as V has them.

    parts: (wall's object index, from, to) along the wall, one for each segment.
    """
    frames = se2.between(area.V.robot, area.V.poses[1:])
    ends, theta = [], []
    for wall, lo, hi in parts:
        x, y, turn = frames[wall]
        along = np.array([np.cos(turn), np.sin(turn)])
        ends.append([np.array([x, y]) + s * along for s in (lo, hi)])
        theta.append(turn)
    k = len(parts)
    both = np.array(ends).reshape(k, 2, 2)
    return SegmentView(
        centre=both.mean(axis=1),
        theta=np.array(theta),
        var_theta=np.full(k, sigma_theta**2),
        var_y=np.full(k, sigma**2),
        ends=both,
        end_kind=np.array(kinds if kinds is not None else [(END_OPEN, END_OPEN)] * k).reshape(k, 2),
        end_sigma=np.full((k, 2), sigma),
        length=np.hypot(*(both[:, 1] - both[:, 0]).T),
    )


def room(
    robot: Sequence[float] = (0.0, 0.0, 0.0),
    sigma: float = 1e-3,
    width: float = 6.0,
    depth: float = 4.0,
    coordinates: str = "invariant",
) -> AreaMap:
    """A rectangular room about the origin, seen from inside: four walls, their free side left."""
    a, b = 0.5 * width, 0.5 * depth
    poses = np.array(
        [
            robot,
            [0.0, -b, 0.0],
            [a, 0.0, 0.5 * np.pi],
            [0.0, b, np.pi],
            [-a, 0.0, -0.5 * np.pi],
        ]
    )
    P = np.diag(np.full(3 + 4 + 12, sigma**2))
    return walls_area(StochasticMap(poses, np.zeros(4), P, coordinates), [a, b, a, b])


def whole_room(area: AreaMap, *, vertices: bool = False) -> SegmentView:
    """All four walls of `room` in one scan, from end to end."""
    f = area.features
    kind = END_VERTEX if vertices else END_OPEN
    parts = [(i, float(f.lo[i]), float(f.hi[i])) for i in range(4)]
    return view_from(area, parts, [(kind, kind)] * 4)


def additive_covariance(V: StochasticMap) -> Array:
    """C(V) of the robot and the objects in additive coordinates, (3 + 3 n, 3 + 3 n)."""
    keep = np.r_[0:3, V.first_object : len(V.covariance)]
    D = block_diag(*(V.additive_D_error(pose) for pose in V.poses))
    return np.asarray(D @ V.covariance[np.ix_(keep, keep)] @ D.T)
