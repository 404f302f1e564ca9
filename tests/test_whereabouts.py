"""What speaks against a place: free space laid on free space, cell by cell."""

from __future__ import annotations

import numpy as np
import pytest

from hiermap_cli.config import Config
from hiermap_cli.estimation.stochastic_map import initial_map
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import EMPTY, AreaMap
from hiermap_cli.mapping.topology.freespace import FreeGrid
from hiermap_cli.mapping.topology.whereabouts import compared, farther_along, seen
from hiermap_cli.perception.sight import Sight
from hiermap_cli.perception.views import SegmentView

LENGTH, WIDTH = 9.0, 2.0
NICHES = (1.0, 3.5, 7.0)  # on the right of the corridor, 0.9 m wide and 0.5 m deep


def ends_from(x, y, heading=0.0):
    """Ends (n, 2), in the robot's frame, of beams from a place in a corridor with niches."""
    out = []
    for angle in np.radians(np.arange(-180.0, 180.0, 1.0)):
        u = np.array([np.cos(angle + heading), np.sin(angle + heading)])
        steps = np.arange(0.0, 12.0, 0.01)
        px, py = x + steps * u[0], y + steps * u[1]
        niche = np.zeros(len(px), dtype=bool)
        for at in NICHES:
            niche |= (px > at) & (px < at + 0.9) & (py > -0.5)
        free = (px > 0.0) & (px < LENGTH) & (py < WIDTH) & ((py > 0.0) | niche)
        r = steps[np.flatnonzero(~free)[0]]
        out.append(r * np.array([np.cos(angle), np.sin(angle)]))
    return np.array(out)


def grid_of(poses):
    """What is seen from poses in the corridor, in the frame of the first one."""
    grid = FreeGrid()
    for pose in poses:
        R = se2.between(np.array(poses[0]), np.array(pose))
        ends = R[:2] + ends_from(*pose) @ se2.rotation(R[2]).T
        for _ in range(2):
            grid.add(R[:2], ends)
    return seen(grid)


def test_nothing_speaks_against_the_true_place_and_doors_against_the_others():
    there = [(x, 1.0, 0.0) for x in (0.5, 2.0, 4.0, 6.0, 8.0)]
    here = [(x, 1.0, np.pi) for x in (5.3, 4.9, 4.5)]
    true = se2.between(np.array(there[0]), np.array(here[0]))
    turned = np.array([0.0, 0.0, np.pi])
    tried = [true, *(true + np.array([x, 0.0, 0.0]) for x in (-2.0, -1.0, 1.0, 2.0)), true + turned]
    found = compared(grid_of(here), grid_of(there), np.array(tried))
    assert found.share[0] > 0.95
    assert found.against[0] < 0.02
    assert found.against[1:].min() > 0.05


def test_who_has_seen_nothing_agrees_with_nothing():
    nothing = seen(FreeGrid())
    found = compared(nothing, grid_of([(2.0, 1.0, 0.0)]), np.zeros((2, 3)))
    assert found.share.tolist() == [0.0, 0.0]
    assert found.against.tolist() == [1.0, 1.0]


THERE = [(x, 1.0, 0.0) for x in (0.5, 2.0, 4.0, 6.0, 8.0)]
WALL = SegmentView(  # on its left, all along the corridor
    np.array([[0.0, 1.0]]), np.array([np.pi]), np.array([1e-6]), np.array([1e-5]),
    np.array([[[1.0, 1.0], [-1.0, 1.0]]]), np.zeros((1, 2), dtype=np.int64),
    np.full((1, 2), 0.05), np.array([2.0]),
)  # fmt: skip


def farther(x, heading, believed, person=()):
    """The answer to a scan from a place in the corridor; person: beams that one has cut short."""
    ends = ends_from(x, 1.0, heading)
    ends[list(person)] *= 0.5
    empty = AreaMap(
        initial_map(np.zeros(3), np.zeros((3, 3)), np.zeros(0), np.zeros((0, 0))), EMPTY
    )
    R = se2.between(np.array(THERE[0]), np.array(believed))
    return farther_along(R, Sight(np.zeros(2), ends), WALL, empty, grid_of(THERE), Config())


@pytest.mark.parametrize("heading", [0.0, np.pi])
def test_a_robot_put_down_farther_along_a_corridor_is_not_where_it_was(heading):
    assert farther(3.0, heading, (5.5, 1.0, 0.0))
    assert not farther(3.0, 0.0, (3.0, 1.0, 0.0))


def test_people_beside_the_robot_do_not_carry_it():
    assert not farther(3.0, 0.0, (3.0, 1.0, 0.0), person=range(60, 110))
