from __future__ import annotations

import gzip
import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from real_data import DATA

from hiermap_cli.documents.tum import TimedPoses, read_tum
from hiermap_cli.evaluation.trajectory import align_se2, ate, poses_at, rpe
from hiermap_cli.geometry.se2 import compose, wrap

SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def evo(tmp_path_factory) -> SimpleNamespace:
    """The parts of evo that are compared with; its settings are written into a spare home."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HOME", str(tmp_path_factory.mktemp("home")))
        metrics = pytest.importorskip("evo.core.metrics")
        trajectory = pytest.importorskip("evo.core.trajectory")
        ape = pytest.importorskip("evo.main_ape")
        relative = pytest.importorskip("evo.main_rpe")
    return SimpleNamespace(
        metrics=metrics, Trajectory=trajectory.PoseTrajectory3D, ape=ape.ape, rpe=relative.rpe
    )


def evo_trajectory(evo, track: TimedPoses):
    half = 0.5 * track.poses[:, 2]
    zero = np.zeros_like(half)
    return evo.Trajectory(
        positions_xyz=np.column_stack((track.poses[:, :2], zero)),
        orientations_quat_wxyz=np.column_stack((np.cos(half), zero, zero, np.sin(half))),
        timestamps=track.stamps_ns / 1e9,
    )


def assert_agrees_with_evo(evo, estimate: TimedPoses, reference: TimedPoses) -> None:
    """Both on equal stamps."""
    relation = evo.metrics.PoseRelation
    ours = ate(*estimate, *reference)
    theirs = evo.ape(
        evo_trajectory(evo, reference),
        evo_trajectory(evo, estimate),
        relation.translation_part,
        align=True,
    ).stats
    assert ours.rmse == pytest.approx(theirs["rmse"], abs=1e-6)
    assert ours.mean == pytest.approx(theirs["mean"], abs=1e-6)
    assert ours.max == pytest.approx(theirs["max"], abs=1e-6)
    assert ours.n == len(estimate.poses)
    relative = rpe(*estimate, *reference)
    for kind, value in (
        (relation.translation_part, relative.trans_rmse),
        (relation.rotation_angle_rad, relative.rot_rmse),
    ):
        result = evo.rpe(
            evo_trajectory(evo, reference),
            evo_trajectory(evo, estimate),
            kind,
            delta=1.0,
            delta_unit=evo.metrics.Unit.meters,
        )
        assert value == pytest.approx(result.stats["rmse"], abs=1e-6)
        assert relative.n == len(result.np_arrays["error_array"])


def walk(seed: int, n: int = 400) -> tuple[TimedPoses, TimedPoses]:
    """A true path and an odometry of it that drifts, in a frame of its own."""
    rng = np.random.default_rng(seed)
    steps = np.column_stack((rng.uniform(0, 0.2, n), np.zeros(n), rng.normal(0, 0.2, n)))
    noisy = steps + rng.normal(0, (0.01, 0.005, 0.02), (n, 3))
    true, drifted = [np.zeros(3)], [np.array([3.0, -2.0, 2.5])]
    for step, worse in zip(steps, noisy, strict=True):
        true.append(compose(true[-1], step))
        drifted.append(compose(drifted[-1], worse))
    stamps = np.arange(n + 1) * SECOND // 5
    return TimedPoses(stamps, np.array(true)), TimedPoses(stamps, np.array(drifted))


@pytest.mark.parametrize("seed", range(5))
def test_ate_and_rpe_agree_with_evo(evo, seed: int) -> None:
    reference, estimate = walk(seed)
    assert_agrees_with_evo(evo, estimate, reference)


@pytest.fixture(scope="module")
def fr079() -> tuple[TimedPoses, TimedPoses]:
    """Raw odometry and the reference trajectory of the log, both as they are."""
    folder = DATA / "fr079"
    if not folder.exists():
        pytest.skip("the real logs are not there")
    stamps, poses = [], []
    with gzip.open(folder / "log.carmen.gz", "rt") as log:
        for words in (line.split() for line in log if line.startswith("ODOM")):
            stamps.append(round(float(words[7]) * 1e9))
            poses.append([float(word) for word in words[1:4]])
    return TimedPoses(np.array(stamps), np.array(poses)), read_tum(folder / "slam_reference.tum")


def test_agrees_with_evo_on_a_real_log(evo, fr079) -> None:
    odometry, reference = fr079
    at, found = poses_at(*odometry, reference.stamps_ns, 0.5)
    assert found.all()
    estimate = TimedPoses(reference.stamps_ns, at)
    assert_agrees_with_evo(evo, estimate, reference)
    assert ate(*odometry, *reference).rmse == pytest.approx(ate(*estimate, *reference).rmse)


def test_equal_trajectories_in_two_frames_have_no_error() -> None:
    reference, _ = walk(7)
    moved = TimedPoses(reference.stamps_ns, compose(np.array([4.0, 5.0, -3.0]), reference.poses))
    result = ate(*moved, *reference)
    assert result.max < 1e-9
    assert compose(result.alignment, moved.poses) == pytest.approx(reference.poses, abs=1e-9)
    assert rpe(*moved, *reference).trans_rmse < 1e-9


def test_interpolates_linearly_and_along_the_shortest_arc() -> None:
    stamps = np.array([0, 2 * SECOND])
    poses = np.array([[0.0, 0.0, 3.0], [2.0, 4.0, -3.0]])
    at, found = poses_at(stamps, poses, np.array([SECOND // 2, SECOND]), 1.0)
    arc = 2.0 * math.pi - 6.0
    expected = np.array([[0.5, 1.0, wrap(3.0 + arc / 4)], [1.0, 2.0, wrap(3.0 + arc / 2)]])
    assert at == pytest.approx(expected)
    assert found.all()


def test_a_stamp_too_far_from_any_pose_is_not_found() -> None:
    stamps = np.array([10, 12]) * SECOND
    poses = np.zeros((2, 3))
    asked = np.array([9.4, 9.5, 10.5, 10.6, 11.0, 11.4, 11.5, 12.5, 12.6])
    found = poses_at(stamps, poses, np.rint(asked * 1e9).astype(np.int64), 0.5).found
    assert found.tolist() == [False, True, True, False, False, False, True, True, False]


def test_stamps_in_any_order_and_repeated() -> None:
    stamps = np.array([2, 0, 1, 1]) * SECOND
    poses = np.array([[2.0, 0, 0], [0, 0, 0], [9.0, 0, 0], [1.0, 0, 0]])
    at, _ = poses_at(stamps, poses, np.array([1, 2]) * SECOND, 0.1)
    assert at[:, 0].tolist() == [1.0, 2.0]


@pytest.mark.parametrize("n", [0, 1])
def test_nothing_in_common_measures_nothing(n: int) -> None:
    stamps, poses = np.arange(n), np.zeros((n, 3))
    reference = np.arange(5) * SECOND, np.zeros((5, 3))
    assert ate(stamps, poses, *reference).metrics() == ()
    assert rpe(stamps, poses, *reference).metrics() == ()


def test_names_and_units_of_the_metrics() -> None:
    reference, estimate = walk(1)
    figures = [*ate(*estimate, *reference).metrics(), *rpe(*estimate, *reference).metrics()]
    assert [(m.name, m.units) for m in figures] == [
        ("ate_rmse", "m"),
        ("ate_mean", "m"),
        ("ate_max", "m"),
        ("rpe_trans_rmse", "m"),
        ("rpe_rot_rmse", "rad"),
    ]


@given(
    st.floats(-10, 10),
    st.floats(-10, 10),
    st.floats(-math.pi, math.pi),
    st.integers(0, 2**32 - 1),
)
def test_alignment_is_the_least_squares_one(x: float, y: float, theta: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = rng.normal(0, 3, (12, 2))
    b = compose(np.array([x, y, theta]), np.column_stack((a, np.zeros(12))))[:, :2]
    b += rng.normal(0, 0.1, b.shape)
    best = align_se2(a, b)

    def cost(pose: np.ndarray) -> float:
        return float(((compose(pose, np.column_stack((a, np.zeros(12))))[:, :2] - b) ** 2).sum())

    for change in np.concatenate((np.eye(3), -np.eye(3))) * 1e-3:
        assert cost(best) <= cost(best + change)


def test_the_alignment_of_a_robot_that_stood_still_is_a_shift() -> None:
    a = np.zeros((4, 2))
    assert align_se2(a, a + np.array([1.0, 2.0])).tolist() == [1.0, 2.0, 0.0]
