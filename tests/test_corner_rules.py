"""Which walls make a corner: how far their ends may be from where they cross, and why."""

from dataclasses import replace

import numpy as np
from landmark_cases import ROOM, found, lines_of

from hiermap_cli.perception.segments import END_FREE, END_OPEN


def test_walls_that_hardly_differ_or_do_not_meet_are_no_corner():
    far = 4.0 * np.array([np.cos(0.3), np.sin(0.3)])
    flat = np.array([[[-4.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], far]])
    assert not found(lines_of(flat), "corner_concave")
    apart = np.array([[[-4.0, 0.0], [-0.5, 0.0]], [[0.0, 0.0], [0.0, 3.0]]])
    assert not found(lines_of(apart), "corner_concave")
    near = np.array([[[-4.0, 0.0], [-0.1, 0.0]], [[0.0, 0.0], [0.0, 3.0]]])
    assert not found(lines_of(near), "corner_concave")  # it ends before


def test_a_wall_not_seen_to_its_end_makes_a_convex_corner_but_no_concave_one():
    """The walls of a convex corner hide each other; those of a concave one do not."""
    not_to_its_end = [[END_OPEN, END_OPEN], [END_FREE, END_FREE]]
    both_open = [[END_OPEN, END_OPEN], [END_OPEN, END_OPEN]]
    for short, expected in ((0.0, True), (0.09, True), (0.12, False)):
        convex = np.array([[[-4.0, 0.0], [-short, 0.0]], [[0.0, 0.0], [0.0, -3.0]]])
        assert bool(found(lines_of(convex, kind=not_to_its_end), "corner_convex")) == expected
        # Nothing says that either of the walls ends there.
        alone = found(lines_of(convex, kind=both_open), "corner_convex")
        assert bool(alone) == (short == 0.0)
    for concave in (ROOM[:2], ROOM[:2] - np.array([[[0.0, 0.0], [0.03, 0.0]], [[0.0, 0.0]] * 2])):
        assert found(lines_of(concave), "corner_concave")
        for kind in (not_to_its_end, both_open, [[END_FREE, END_FREE], [END_OPEN, END_FREE]]):
            assert not found(lines_of(concave, kind=kind), "corner_concave")


def test_an_edge_before_a_wall_is_no_corner():
    """It stops short of the wall, and the wall was seen beyond it: either may be an error."""
    short = np.array([[[-4.0, 0.0], [-0.045, 0.0]], [[0.0, 0.0], [0.0, 3.0]]])
    assert found(lines_of(short), "corner_concave")
    short[1, 0, 1] = -0.04
    assert not found(lines_of(short), "corner_concave")


def test_an_end_that_is_hardly_known_is_no_corners():
    """The other wall may go on behind it."""
    lines = lines_of(ROOM[:2])
    assert found(lines, "corner_concave")
    vague = lines.covariance.copy()
    vague[3, 3] = 0.1**2  # of the place where the first wall ends
    assert not found(replace(lines, covariance=vague), "corner_concave")
