"""Area frames in g from the crossings: derivatives, samples, and batch least squares for loops."""

from __future__ import annotations

import numpy as np
import pytest
from estimation_cases import derivative, random_covariance, random_pose
from scipy.optimize import least_squares

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.environment import Anchors, Link, compose_environment

START = np.array([1.0, -2.0, 0.4])
# Areas 0 and 1 and 2 in a row, 3 beside 1: each discovered by its own crossing.
TREE = (Link(0, 1, 1, 1), Link(1, 2, 2, 1), Link(1, 3, 3, 1))
ANCHORS = (1, 3, 1, 1)  # in each area, beside the robot


def split(vector, counts):
    return np.split(vector.reshape(-1, 3), np.cumsum(counts)[:-1])


def areas_of(rng, anchors, sigma=0.05, origins=True):
    """Robot and anchors of each area. An area begins at its first anchor, which is exact."""
    areas = []
    for i, k in enumerate(anchors):
        poses = np.array([random_pose(rng) for _ in range(1 + k)])
        C = random_covariance(rng, 3 + 3 * k, sigma)
        if origins and i > 0:
            poses[1] = 0.0
            C[3:6], C[:, 3:6] = 0.0, 0.0
        areas.append(Anchors(poses, C))
    return areas


def truth_of(areas, tree, e, start):
    """Frames and anchors where root and anchors are off by e (invariant errors)."""
    counts = [1, *(len(a.poses) for a in areas)]
    steps = split(e, counts)
    root = se2.compose(se2.exp(steps[0][0]), start)
    poses = [se2.compose(se2.exp(s), a.poses) for s, a in zip(steps[1:], areas, strict=True)]
    frames = {0: root}
    for link in tree:
        crossing = se2.compose(frames[link.a], poses[link.a][link.anchor_a])
        frames[link.b] = se2.compose(crossing, se2.invert(poses[link.b][link.anchor_b]))
    return np.array([frames[i] for i in range(len(areas))]), poses


def error_vector(frames, poses, environment):
    told = np.vstack((environment.frames, *environment.anchors))
    return se2.log(se2.compose(np.vstack((frames, *poses)), se2.invert(told))).ravel()


def prior(areas, C_start):
    N = 3 + sum(len(a.covariance) for a in areas)
    P, at = np.zeros((N, N)), 3
    P[:3, :3] = C_start
    for area in areas:
        n = len(area.covariance)
        P[at : at + n, at : at + n] = area.covariance
        at += n
    return P


@pytest.mark.parametrize("seed", range(4))
def test_a_tree_by_central_differences(seed):
    rng = np.random.default_rng(seed)
    areas, C_start = areas_of(rng, ANCHORS, origins=seed % 2 == 0), random_covariance(rng, 3)
    environment = compose_environment(areas, TREE, START, C_start)
    P = prior(areas, C_start)
    frames, poses = truth_of(areas, TREE, np.zeros(len(P)), START)
    assert environment.frames == pytest.approx(frames)
    assert np.vstack(environment.anchors) == pytest.approx(np.vstack(poses))
    J = derivative(lambda e: error_vector(*truth_of(areas, TREE, e, START), environment), len(P))
    assert np.allclose(environment.covariance, J @ P @ J.T, rtol=0, atol=1e-9)


def test_a_tree_against_samples():
    """Drawn anchors, composed: means and covariances of the frames, as far as 20000 draws tell."""
    rng = np.random.default_rng(5)
    areas, C_start = areas_of(rng, ANCHORS, sigma=0.01), random_covariance(rng, 3, 0.01)
    environment = compose_environment(areas, TREE, START, C_start)
    P = prior(areas, C_start)
    n = 20000
    draws = rng.multivariate_normal(np.zeros(len(P)), P, size=n, method="eigh")
    K = len(areas)
    errors = np.zeros((n, 3 * K))
    e = draws.reshape(n, -1, 3)
    first = np.cumsum([1, *(len(a.poses) for a in areas)])
    frames = {0: se2.compose(se2.exp(e[:, 0]), START)}

    def pose(area, anchor):
        step = se2.exp(e[:, first[area] + anchor])
        return se2.compose(step, areas[area].poses[anchor])

    for link in TREE:
        crossing = se2.compose(frames[link.a], pose(link.a, link.anchor_a))
        frames[link.b] = se2.compose(crossing, se2.invert(pose(link.b, link.anchor_b)))
    for i in range(K):
        told = se2.invert(environment.frames[i])
        errors[:, 3 * i : 3 * i + 3] = se2.log(se2.compose(frames[i], told))
    C = environment.covariance[: 3 * K, : 3 * K]
    sigma = np.sqrt(np.diagonal(C))
    assert np.abs(errors.mean(axis=0) / sigma).max() < 5 / np.sqrt(n) + 0.05
    sampled = errors.T @ errors / n
    assert np.abs((sampled - C) / np.outer(sigma, sigma)).max() < 0.05


def test_covariances_are_found_by_frame_and_by_anchor():
    rng = np.random.default_rng(6)
    areas = areas_of(rng, ANCHORS)
    environment = compose_environment(areas, TREE, START, np.zeros((3, 3)))
    for i, area in enumerate(areas):
        block = environment.covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        assert np.array_equal(environment.frame_covariance(i), block)
        for k in range(len(area.poses)):
            at = environment.offset(i, k)
            assert environment.covariance[at : at + 3, at : at + 3] == pytest.approx(
                area.covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
            )


def test_the_first_area_lies_where_the_start_is():
    rng = np.random.default_rng(7)
    areas = areas_of(rng, ANCHORS)
    exact = compose_environment(areas, TREE, START, np.zeros((3, 3)))
    assert np.array_equal(exact.frames[0], START)
    assert not exact.frame_covariance(0).any()
    assert np.linalg.eigvalsh(exact.frame_covariance(2)).min() > 0.0


def test_one_area_alone():
    (area,) = areas_of(np.random.default_rng(8), (0,))
    environment = compose_environment([area], [], START, 0.01 * np.eye(3))
    assert environment.frames == pytest.approx(START[None])
    assert environment.covariance[3:, 3:] == pytest.approx(area.covariance)
    assert environment.covariance[:3, :3] == pytest.approx(0.01 * np.eye(3))


def test_an_area_that_nothing_joins_is_a_fault_of_the_program():
    areas = areas_of(np.random.default_rng(9), ANCHORS)
    with pytest.raises(AssertionError, match="no crossing"):
        compose_environment(areas, TREE[:2], START, np.zeros((3, 3)))


# --- loops ---

RING = (Link(0, 1, 1, 1), Link(1, 2, 2, 1), Link(2, 2, 0, 2))
RING_ANCHORS = (2, 2, 2)


def ring(rng, sigma, off=1.0):
    """Three areas in a ring; the closing crossing is off by errors that their covariances have,
    `off` times as large. Each area but the first begins at its first anchor."""
    areas = areas_of(rng, RING_ANCHORS, sigma)
    frames, poses = truth_of(areas, RING[:2], np.zeros(3 + 27), START)
    # The place of the third crossing as seen from area 2 is where area 0 has it.
    crossing = se2.compose(frames[2], poses[2][2])
    true = [area.poses.copy() for area in areas]
    true[0][2] = se2.between(frames[0], crossing)
    exact = [Anchors(p, a.covariance) for p, a in zip(true, areas, strict=True)]
    noisy = []
    for area in exact:
        e = off * rng.multivariate_normal(
            np.zeros(len(area.covariance)), area.covariance, method="eigh"
        )
        noisy.append(area._replace(poses=se2.compose(se2.exp(e.reshape(-1, 3)), area.poses)))
    return exact, noisy, frames


def batch(areas, links, tree, start, C_start, weight=1e4):
    """The same factors by Gauss-Newton over independent unit causes; the loop weighs so much
    that it holds. Returns e, and its covariance."""
    P = prior(areas, C_start)
    values, vectors = np.linalg.eigh(P)
    L = vectors * np.sqrt(np.maximum(values, 0.0))
    L = L[:, values > 1e-14]
    scale = np.sqrt(np.diagonal(P).max())

    def residuals(u):
        frames, poses = truth_of(areas, tree, L @ u, start)
        gaps = [
            se2.log(
                se2.compose(
                    se2.compose(frames[link.a], poses[link.a][link.anchor_a]),
                    se2.invert(se2.compose(frames[link.b], poses[link.b][link.anchor_b])),
                )
            )
            for link in links
        ]
        return np.concatenate((u, weight / scale * np.ravel(gaps)))

    found = least_squares(residuals, np.zeros(L.shape[1]), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    C = L @ np.linalg.inv(found.jac.T @ found.jac) @ L.T
    return L @ found.x, C


@pytest.mark.parametrize("seed", range(4))
def test_a_loop_is_batch_least_squares(seed):
    """Small errors, for which both linearise alike: frames, anchors and joint covariance."""
    rng = np.random.default_rng(seed)
    sigma = 1e-3
    _, areas, _ = ring(rng, sigma)
    C_start = random_covariance(rng, 3, sigma)
    environment = compose_environment(areas, RING, START, C_start)
    e, C = batch(areas, RING[2:], RING[:2], START, C_start)
    frames, poses = truth_of(areas, RING[:2], e, START)
    assert environment.frames == pytest.approx(frames, abs=0.01 * sigma)
    for told, expected in zip(environment.anchors, poses, strict=True):
        assert told == pytest.approx(expected, abs=0.01 * sigma)
    J = derivative(
        lambda d: error_vector(*truth_of(areas, RING[:2], e + d, START), environment), len(e)
    )
    D = J @ C @ J.T
    assert np.abs(environment.covariance - D).max() < 0.02 * np.abs(D).max()


def test_a_closed_loop_is_closed_and_surer_than_an_open_one():
    rng = np.random.default_rng(10)
    _, areas, _ = ring(rng, 0.03)
    closed = compose_environment(areas, RING, START, np.zeros((3, 3)))
    gap = [se2.compose(closed.frames[i], closed.anchors[i][k]) for i, k in ((2, 2), (0, 2))]
    assert gap[0] == pytest.approx(gap[1], abs=1e-9)
    opened = compose_environment(areas, RING[:2], START, np.zeros((3, 3)))
    for i in (1, 2):
        assert np.trace(closed.frame_covariance(i)) < np.trace(opened.frame_covariance(i))
        assert (
            np.linalg.eigvalsh(opened.frame_covariance(i) - closed.frame_covariance(i))[0] > -1e-12
        )
    # What closed it is as certain seen from the one side as from the other.
    N = len(closed.covariance)
    G = np.zeros((3, N))
    for i, k, sign in ((2, 2, 1.0), (0, 2, -1.0)):
        at = closed.offset(i, k)
        G[:, 3 * i : 3 * i + 3] += sign * np.eye(3)
        G[:, at : at + 3] += sign * se2.adjoint(closed.frames[i])
    assert np.abs(G @ closed.covariance @ G.T).max() < 1e-9


def test_a_loop_corrects_anchors_and_leaves_what_is_exact():
    """The origins of areas 1 and 2 are exact in them; robot and crossings there move."""
    rng = np.random.default_rng(11)
    exact, areas, frames = ring(rng, 0.03, off=2.0)
    closed = compose_environment(areas, RING, START, np.zeros((3, 3)))
    for i in (1, 2):
        assert closed.anchors[i][1] == pytest.approx(areas[i].poses[1], abs=1e-14)
        assert np.abs(closed.anchors[i][2] - areas[i].poses[2]).max() > 1e-3
        assert np.abs(closed.anchors[i][0] - areas[i].poses[0]).max() > 1e-4  # by correlation
    assert closed.frames[0] == pytest.approx(START, abs=1e-15)
    assert frames[2] == pytest.approx(closed.frames[2], abs=0.5)
    # Without errors there is nothing to correct.
    right = compose_environment(exact, RING, START, np.zeros((3, 3)))
    assert right.frames == pytest.approx(frames, abs=1e-9)
    assert np.vstack(right.anchors) == pytest.approx(np.vstack([a.poses for a in exact]), abs=1e-9)


def test_closing_loops_is_right_in_the_mean():
    """NEES of all frames after the loop, over 200 draws: 1 a degree of freedom."""
    values = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        exact, areas, _ = ring(rng, 0.02)
        closed = compose_environment(areas, RING, START, np.zeros((3, 3)))
        frames, _ = truth_of(exact, RING[:2], np.zeros(30), START)
        e = se2.log(se2.compose(frames, se2.invert(closed.frames)))[1:].ravel()
        values.append(e @ np.linalg.solve(closed.covariance[3:9, 3:9], e) / 6.0)
    assert np.mean(values) == pytest.approx(1.0, abs=4 * np.sqrt(2 / (6 * 200)))


def test_moving_everything_moves_the_frames_alike():
    """The gauge: another start is another global frame, and nothing else."""
    rng = np.random.default_rng(12)
    _, areas, _ = ring(rng, 0.03)
    a = compose_environment(areas, RING, START, np.zeros((3, 3)))
    R_h_g = random_pose(rng)
    b = compose_environment(areas, RING, se2.compose(R_h_g, START), np.zeros((3, 3)))
    assert b.frames == pytest.approx(se2.compose(R_h_g, a.frames), abs=1e-8)
    for one, other in zip(a.anchors, b.anchors, strict=True):
        assert one == pytest.approx(other, abs=1e-8)
    Ad = np.kron(np.eye(3), se2.adjoint(R_h_g))
    assert np.allclose(b.covariance[:9, :9], Ad @ a.covariance[:9, :9] @ Ad.T, rtol=0, atol=1e-9)


def test_the_starts_uncertainty_is_on_every_frame_and_in_no_area():
    rng = np.random.default_rng(13)
    _, areas, _ = ring(rng, 0.03)
    C = random_covariance(rng, 3, 0.2)
    a = compose_environment(areas, RING, START, np.zeros((3, 3)))
    b = compose_environment(areas, RING, START, C)
    assert b.frames == pytest.approx(a.frames, abs=1e-9)
    extra = b.covariance - a.covariance
    assert np.allclose(extra[:9, :9], np.tile(C, (3, 3)), rtol=0, atol=1e-8)
    assert np.abs(extra[9:]).max() < 1e-8
