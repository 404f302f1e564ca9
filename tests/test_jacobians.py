"""Every analytic Jacobian of the project against central differences.

`TABLE` holds one entry for each public function with `_D_` in its name under the packages named
in `PACKAGES`; a function that is not listed fails. An entry says how to draw arguments, and which
function of a small step `e` the Jacobian claims to be the derivative of at e = 0.
"""

import importlib
import inspect
import pkgutil
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

import hiermap_cli
from hiermap_cli.geometry import lines, points, se2
from hiermap_cli.mapping.areas import doors
from hiermap_cli.perception.kinds import corner, corridor, crossing, door, lineset

PACKAGES = ("geometry", "perception", "estimation", "mapping")
STEP = 1e-6
DRAWS = 25


class Entry(NamedTuple):
    """A Jacobian, arguments for it, and what it is the derivative of.

    sample: generator -> the arguments of `function`.
    reference: (e, *arguments) -> vector, with e a vector of `size` components about zero.
    """

    function: Callable[..., Any]
    sample: Callable[[np.random.Generator], tuple[Any, ...]]
    reference: Callable[..., Any]
    size: int


def pose(rng):
    return np.array([*rng.uniform(-5, 5, 2), rng.uniform(-1.4, 1.4)])


def point(rng):
    return rng.uniform(-5, 5, 2)


def hesse(rng):
    return np.array([rng.uniform(-1.4, 1.4), rng.uniform(-5, 5)])


def hesse_in_chart(rng):
    S = hesse(rng)
    return S, lines.chart(S)


def crossing_lines(rng):
    first = hesse(rng)
    return first, np.array([first[0] + rng.uniform(0.4, 1.5), rng.uniform(-5, 5)])


def facing_lines(rng):
    first = hesse(rng)
    return np.array([first, [first[0] + np.pi + rng.uniform(-0.1, 0.1), rng.uniform(-5, 5)]])


def jamb_lines(rng):
    first = hesse(rng)
    return np.array([first, [first[0] + rng.uniform(-0.2, 0.2), rng.uniform(-5, 5)]])


def moved_jamb_on_line(e, S, jambs, k):
    """Alpha 1, jamb 1, alpha 2, jamb 2, with one of the jambs put on the other one's line."""
    hesse, points = S.copy(), jambs.copy()
    for i in range(2):
        hesse[i, 0] += e[3 * i]
        points[i] += e[3 * i + 1 : 3 * i + 3]
    out = door.jamb_on_line(hesse, points, k)
    return np.concatenate(([hesse[0, 0]], out[0], [hesse[1, 0]], out[1]))


def moved_jambs(e, S, jambs, choice, weight):
    """The door of jamb lines and points changed by e = (alpha1, x1, y1, alpha2, x2, y2)."""
    angles = S + np.array([[e[0], 0.0], [e[3], 0.0]])
    return door.door_pose(angles, jambs + e.reshape(2, 3)[:, 1:], choice, weight)


def centred(rng):
    return rng.uniform(-1.4, 1.4), point(rng)


def through_centre(e, alpha, centre):
    """The line (alpha, d) whose angle and offset at the centre are changed by e."""
    n = np.array([np.cos(alpha + e[0]), np.sin(alpha + e[0])])
    return np.array([alpha + e[0], n @ centre + e[1]])


TABLE = [
    Entry(
        se2.compose_D_first,
        lambda rng: (pose(rng), pose(rng)),
        lambda e, a, b: se2.compose(a + e, b),
        3,
    ),
    Entry(
        se2.compose_D_second,
        lambda rng: (pose(rng), pose(rng)),
        lambda e, a, b: se2.compose(a, b + e),
        3,
    ),
    Entry(se2.invert_D_pose, lambda rng: (pose(rng),), lambda e, a: se2.invert(a + e), 3),
    Entry(
        se2.additive_D_invariant,
        lambda rng: (pose(rng),),
        lambda e, a: se2.compose(se2.exp(e), a),
        3,
    ),
    Entry(
        se2.invariant_D_additive,
        lambda rng: (pose(rng),),
        lambda e, a: se2.log(se2.compose(a + e, se2.invert(a))),
        3,
    ),
    Entry(
        points.h_D_pose, lambda rng: (pose(rng), point(rng)), lambda e, R, P: points.h(R + e, P), 3
    ),
    Entry(
        points.h_D_point, lambda rng: (pose(rng), point(rng)), lambda e, R, P: points.h(R, P + e), 2
    ),
    Entry(
        lines.hesse_to_pq_D_hesse,
        hesse_in_chart,
        lambda e, S, kind: lines.hesse_to_pq(S + e, kind),
        2,
    ),
    Entry(
        lines.g_hesse_D_pose,
        lambda rng: (pose(rng), hesse(rng)),
        lambda e, R, S: lines.g_hesse(R + e, S),
        3,
    ),
    Entry(
        lines.g_hesse_D_line,
        lambda rng: (pose(rng), hesse(rng)),
        lambda e, R, S: lines.g_hesse(R, S + e),
        2,
    ),
    Entry(lines.hesse_D_centred, centred, through_centre, 2),
    Entry(
        lines.intersect_D_lines,
        crossing_lines,
        lambda e, a, b: lines.intersect(a + e[:2], b + e[2:]),
        4,
    ),
    Entry(
        lineset.point_on_D_line,
        lambda rng: (hesse(rng), rng.uniform(-3, 3)),
        lambda e, S, s: lineset.point_on(S + e[:2], s + e[2]),
        3,
    ),
    Entry(
        corner.corner_pose_D_lines,
        lambda rng: (*crossing_lines(rng), rng.integers(2)),
        lambda e, a, b, choice: corner.corner_pose(a + e[:2], b + e[2:], choice),
        4,
    ),
    Entry(
        corner.corner_shape_D_lines,
        lambda rng: (*crossing_lines(rng), rng.integers(2)),
        lambda e, a, b, choice: corner.corner_shape(a + e[:2], b + e[2:], choice)[0],
        4,
    ),
    Entry(
        door.door_pose_D_jambs,
        lambda rng: (jamb_lines(rng), rng.uniform(-2, 2, (2, 2)), rng.integers(4), 0.3),
        moved_jambs,
        6,
    ),
    Entry(
        door.jamb_on_line_D_jambs,
        lambda rng: (jamb_lines(rng), rng.uniform(-2, 2, (2, 2)), int(rng.integers(2))),
        moved_jamb_on_line,
        6,
    ),
    Entry(
        corridor.corridor_pose_D_lines,
        lambda rng: (facing_lines(rng), point(rng)),
        lambda e, S, near: corridor.corridor_pose(S + e.reshape(2, 2), near, corridor.FIRST),
        4,
    ),
    Entry(
        crossing.crossing_pose_D_lines,
        lambda rng: (np.concatenate((crossing_lines(rng), crossing_lines(rng))),),
        lambda e, S: crossing.crossing_pose(S + e.reshape(4, 2)),
        8,
    ),
    Entry(
        lineset.foot_D_line,
        lambda rng: (hesse(rng), point(rng)),
        lambda e, S, P: lineset.foot(S + e, P),
        2,
    ),
    Entry(
        doors.on_wall_D_passed,
        lambda rng: (hesse(rng),),
        lambda e, S: doors.on_wall(np.array([2.0, -1.0, 0.4]) + e, S),
        3,
    ),
    Entry(
        doors.on_wall_D_line,
        lambda rng: (pose(rng), hesse(rng)),
        lambda e, passed, S: doors.on_wall(passed, S + e),
        2,
    ),
]


def public_jacobians():
    """Every public function with `_D_` in its name, by its full name."""
    found = {}
    for package in PACKAGES:
        root = importlib.import_module(f"hiermap_cli.{package}")
        modules = [root.__name__]
        modules += [m.name for m in pkgutil.walk_packages(root.__path__, f"{root.__name__}.")]
        for name in modules:
            module = importlib.import_module(name)
            for attribute, value in vars(module).items():
                if (
                    "_D_" in attribute
                    and not attribute.startswith("_")
                    and inspect.isfunction(value)
                    and value.__module__ == name
                ):
                    found[f"{name}.{attribute}"] = value
    return found


def numeric(entry, arguments):
    columns = []
    for k in range(entry.size):
        e = np.zeros(entry.size)
        e[k] = STEP
        plus = np.asarray(entry.reference(e, *arguments))
        minus = np.asarray(entry.reference(-e, *arguments))
        columns.append((plus - minus) / (2 * STEP))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("entry", TABLE, ids=lambda entry: entry.function.__qualname__)
def test_meets_central_differences(entry):
    rng = np.random.default_rng(7)
    for _ in range(DRAWS):
        arguments = entry.sample(rng)
        analytic = np.asarray(entry.function(*arguments))
        expected = numeric(entry, arguments)
        assert analytic.shape == expected.shape
        scale = 1.0 + np.abs(expected).max()
        np.testing.assert_allclose(analytic, expected, atol=2e-8 * scale, rtol=1e-7)


def test_every_public_jacobian_is_listed():
    assert hiermap_cli.__name__ == "hiermap_cli"
    listed = {entry.function for entry in TABLE}
    missing = sorted(name for name, value in public_jacobians().items() if value not in listed)
    assert not missing, f"give {missing} an entry in TABLE"


def test_the_search_for_jacobians_finds_them():
    assert "hiermap_cli.geometry.se2.compose_D_first" in public_jacobians()
