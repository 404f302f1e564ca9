"""The refined levels are one estimate: what is told of one wall moves all that hangs on it."""

from __future__ import annotations

import numpy as np
import pytest
from test_refinement_run import ring

from hiermap_cli.estimation.fronts import factorise
from hiermap_cli.estimation.motion import PARAMETERS
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import WALL
from hiermap_cli.mapping.refinement.problem import layout, stepped
from hiermap_cli.mapping.refinement.smoothing import assemble


def test_a_wall_that_is_told_to_lie_elsewhere_moves_all_that_hangs_on_it():
    """The first area's frame is where g begins: what its C(V) says of a wall and the rest is
    what the whole does when it is solved once more with the wall told to lie elsewhere."""
    _, mapper, _, refined = ring(0)
    solution, V, f = refined.solution, refined.areas[0].V, refined.areas[0].features
    state, where = solution.state, layout(solution.state)
    told = int(np.bincount(refined.matched.wall).argmax())
    shift = 0.01
    pieces = assemble(where, solution.structure, solution.terms, state, mapper.config)
    column = where.wall(np.array([told]))[0, :1]
    piece = next(one for one in pieces if column[0] in one.columns)
    at = np.searchsorted(piece.columns, column[0])
    piece.H[at, at] += 1e10
    piece.g[at] += 1e10 * shift
    x = factorise(pieces, solution.structure.plan, where.size).solve()
    assert x[column[0]] == pytest.approx(shift, rel=1e-3)
    moved = stepped(state, x)
    steps = np.hypot(*(moved.poses - state.poses)[:, :2].T)
    assert np.median(steps) > 1e-4  # of the trajectory
    assert steps[-1] > 1e-4
    across = x[where.parameters + PARAMETERS :][: 2 * where.walls : 2]
    assert np.mean(np.abs(across) > 1e-6) > 0.95  # of the other walls, in all areas
    # The wall as the area has it, and what the area's covariance says goes with it.
    n = np.array([-np.sin(state.walls.poses[told, 2]), np.cos(state.walls.poses[told, 2])])
    t = np.array([n[1], -n[0]])
    G = se2.between(state.poses[refined.frames[0]], np.append(state.walls.poses[told, :2], 0.0))
    off = V.poses[1:, :2] - G[:2]
    same = np.abs(se2.wrap(V.poses[1:, 2] - state.walls.poses[told, 2])) < 1e-9
    same &= (np.abs(off @ n) < 1e-9) & (f.kind == WALL)
    (k,) = np.flatnonzero(same)
    # The shift of the wall's origin in g, that lies `off` along it.
    row = np.zeros(len(V.covariance))
    Ad = se2.adjoint(se2.invert(V.poses[1 + k]))
    row[V.columns(1 + k)] = Ad[1] - (off[k] @ t) * Ad[2]
    regression = V.covariance @ row / (row @ V.covariance @ row) * x[column[0]]
    after = se2.compose(se2.between(moved.poses[0], moved.poses), np.zeros(3))
    before = se2.between(state.poses[0], state.poses)
    key = refined.last[0]
    error = se2.log(se2.compose(after[key], se2.invert(before[key])))
    np.testing.assert_allclose(error, regression[:3], atol=1e-5)
    assert np.abs(regression[V.first_object :]).max() > 1e-4
