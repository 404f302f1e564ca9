"""Lines and points against the algebra that defines them."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hiermap_cli.geometry import lines
from hiermap_cli.geometry.points import h
from hiermap_cli.geometry.se2 import compose, invert

ANGLE = st.floats(-3.14, 3.14)
METRES = st.floats(-20.0, 20.0)
POSE = st.tuples(METRES, METRES, ANGLE).map(np.array)
HESSE = st.tuples(ANGLE, METRES).map(np.array)
POINT = st.tuples(METRES, METRES).map(np.array)


def distance(hesse, point):
    """Signed distance of a point beyond a line, along its normal."""
    normal = np.array((np.cos(hesse[0]), np.sin(hesse[0])))
    return normal @ point - hesse[1]


def on_the_line(hesse, along=1.0):
    normal = np.array((np.cos(hesse[0]), np.sin(hesse[0])))
    return hesse[1] * normal + along * np.array((-normal[1], normal[0]))


def same_line(a, b, atol=1e-9):
    """Whether two lines are one, whatever side their normals point to."""
    turn = a[0] - b[0]
    side = np.sign(np.cos(turn))
    return abs(np.sin(turn)) < atol and abs(a[1] - side * b[1]) < atol * (1 + abs(a[1]))


def points_of(pq, line_type):
    """Two points that satisfy the line's equation in its chart."""
    u = np.array((-1.0, 2.0))
    v = pq[0] * u + pq[1]
    return np.stack((v, u) if line_type == 0 else (u, v), axis=1)


@given(R_a_b=POSE, S_b=HESSE, along=METRES)
def test_g_moves_a_line_as_h_moves_its_points(R_a_b, S_b, along):
    S_a = lines.g_hesse(R_a_b, S_b)
    assert abs(distance(S_a, h(R_a_b, on_the_line(S_b, along)))) < 1e-9


@given(R_a_b=POSE, S_b=HESSE, P_b=POINT)
def test_g_keeps_distances_and_sides(R_a_b, S_b, P_b):
    S_a = lines.g_hesse(R_a_b, S_b)
    assert abs(distance(S_a, h(R_a_b, P_b)) - distance(S_b, P_b)) < 1e-9


@given(R_a_b=POSE, R_b_c=POSE, S_c=HESSE)
def test_g_composes(R_a_b, R_b_c, S_c):
    step = lines.g_hesse(R_a_b, lines.g_hesse(R_b_c, S_c))
    assert same_line(lines.g_hesse(compose(R_a_b, R_b_c), S_c), step)


@given(R_a_b=POSE, R_b_c=POSE, P_c=POINT)
def test_h_composes(R_a_b, R_b_c, P_c):
    step = h(R_a_b, h(R_b_c, P_c))
    np.testing.assert_allclose(h(compose(R_a_b, R_b_c), P_c), step, atol=1e-9)


@given(R_r_l=POSE, alpha=ANGLE)
def test_a_line_through_a_landmarks_origin_has_no_offset_there(R_r_l, alpha):
    # Section 5.1 prints the inverse in the other place: seen by the robot, the line passes the
    # landmark's origin; in the landmark's frame it must pass the frame's.
    normal = np.array((np.cos(alpha), np.sin(alpha)))
    S_r = np.array((alpha, normal @ R_r_l[:2]))
    S_l = lines.g_hesse(invert(R_r_l), S_r)
    assert abs(S_l[1]) < 1e-9
    np.testing.assert_allclose(h(invert(R_r_l), R_r_l[:2]), 0.0, atol=1e-9)


@given(S=HESSE)
def test_charts_hold_the_same_points(S):
    kind = lines.chart(S)
    pq = lines.hesse_to_pq(S, kind)
    assert abs(pq[0]) <= 1.0 + 1e-9
    for point in points_of(pq, kind):
        assert abs(distance(S, point)) < 1e-8


@given(R_a_b=POSE, S_b=HESSE)
def test_a_line_moved_there_and_back_keeps_its_covariance(R_a_b, S_b):
    C_b = np.array(((4e-4, 1e-4), (1e-4, 9e-4)))
    there = lines.g_hesse_D_line(R_a_b, S_b)
    back = lines.g_hesse_D_line(invert(R_a_b), lines.g_hesse(R_a_b, S_b))
    C_a = there @ C_b @ there.T
    np.testing.assert_allclose(back @ C_a @ back.T, C_b, atol=1e-9)


@given(a=HESSE, turn=st.floats(0.3, 2.8), d=METRES)
def test_lines_meet_on_both(a, turn, d):
    b = np.array((a[0] + turn, d))
    P = lines.intersect(a, b)
    assert abs(distance(a, P)) < 1e-8
    assert abs(distance(b, P)) < 1e-8


def test_the_normal_of_a_segment_is_on_its_right():
    S = lines.hesse_from_points(np.array((0.0, -1.0)), np.array((0.0, 1.0)))
    np.testing.assert_allclose(S, (0.0, 0.0), atol=1e-12)
    S = lines.hesse_from_points(np.array((2.0, 3.0)), np.array((1.0, 3.0)))
    np.testing.assert_allclose(S, (np.pi / 2, 3.0), atol=1e-12)


def test_leading_axes_are_batch_axes():
    rng = np.random.default_rng(1)
    R, S = rng.normal(size=(4, 1, 3)), rng.normal(size=(5, 2))
    moved = lines.g_hesse(R, S)
    assert moved.shape == (4, 5, 2)
    assert lines.g_hesse_D_pose(R, S).shape == (4, 5, 2, 3)
    assert lines.g_hesse_D_line(R, S).shape == (4, 5, 2, 2)
    assert lines.hesse_to_pq(S, lines.chart(S)).shape == (5, 2)
    for i, j in np.ndindex(4, 5):
        np.testing.assert_allclose(moved[i, j], lines.g_hesse(R[i, 0], S[j]))
