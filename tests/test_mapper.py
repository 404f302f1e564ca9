"""The filter over whole simulated logs: exact without noise, honest with it, and hard to lose."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from estimation_cases import assembled
from world_cases import DATASETS, SMALL_WORLDS, TWO_ROOMS, world_of

from hiermap_cli.config import Config, NoiseConfig
from hiermap_cli.evaluation.consistency import first_pose_alignment, landmark_nees, robot_nees
from hiermap_cli.evaluation.trajectory import ate
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.filtering import run_filter
from hiermap_cli.mapping.mapper import TOLD_EVERY, Mapper
from hiermap_cli.mapping.run import map_log
from hiermap_cli.simulation.simulator import simulate
from hiermap_cli.simulation.world import build_world, load_world

NO_LEARNING = Config(noise=NoiseConfig(estimate=False))


def world(name, **changes):
    """A world of datasets/, some of its sections changed."""
    given = load_world(DATASETS / f"{name}.yaml")
    if not changes:
        return given
    spec = given.spec
    sections = {
        section: getattr(spec, section).model_copy(update=values)
        for section, values in changes.items()
    }
    return build_world(spec.model_copy(update=sections))


@cache
def log_of(name, *, seed=1, noiseless=False):
    simulation = simulate(world(name), np.random.default_rng(seed), noiseless=noiseless)
    return simulation, tuple(simulation.blocks())


def cut(blocks, scans):
    """The first scans of a log."""
    out = []
    for block in blocks:
        n = min(len(block), scans)
        scans -= n
        if n:
            out.append(block.part(np.arange(n)))
    return out


def filtered(blocks, config=None):
    """The mapper and its result."""
    mapper, _ = run_filter(iter(blocks), Config() if config is None else config)
    return mapper, assembled(mapper)


@cache
def run(name, *, seed=1, noiseless=False):
    simulation, blocks = log_of(name, seed=seed, noiseless=noiseless)
    return (simulation, *filtered(blocks))


def errors(simulation, result):
    """Errors (N, 3) of the trajectory, which begins where the truth begins."""
    truth = se2.between(simulation.truth[0], simulation.truth)
    e = result.trajectory.poses - truth[: len(result.trajectory.poses)]
    e[:, 2] = se2.wrap(e[:, 2])
    return e


def kinds(mapper):
    return [event.kind for event in mapper.events]


# --- without noise ---


@pytest.mark.parametrize("name", SMALL_WORLDS)
def test_without_noise_the_trajectory_has_no_error(name):
    """But for the rounding of float32 ranges: 0.1 mm, 0.1 mrad, over the whole of the drive."""
    simulation, _, result = run(name, noiseless=True)
    assert np.abs(errors(simulation, result)).max() < 1e-4


@pytest.mark.parametrize("name", SMALL_WORLDS)
def test_without_noise_nothing_fails(name):
    _, mapper, _ = run(name, noiseless=True)
    assert not {"matching_failed", "odometry_failed", "relocated"} & set(kinds(mapper))
    assert mapper.counts.failed == 0
    assert np.abs(mapper.area.V.parameters).max() < 1e-4


@pytest.mark.parametrize("name", SMALL_WORLDS)
def test_without_noise_the_noise_is_found_to_be_small(name):
    """Walls that are lines, a laser without error: the configured figures are far too large."""
    _, mapper, _ = run(name, noiseless=True)
    assert mapper.noise.walls < 0.02
    assert mapper.noise.laser < 0.02


# --- with noise ---

SEEDS = (1, 2, 3, 4)


def test_errors_are_as_large_as_their_covariances_say():
    """Four drives around the room of figure 8; the NEES of one drive goes on from scan to scan,
    so that these are some tens of independent values. `make test-slow` has fifty drives."""
    values, sigmas, worst = [], [], []
    for seed in SEEDS:
        simulation, _, result = run("room", seed=seed)
        nees = robot_nees(result.trajectory, simulation.stamps_ns, simulation.truth)
        assert nees.n > 0.95 * len(simulation.stamps_ns)
        values.append(nees.mean)
        C = result.trajectory.covariances
        sigmas.append(np.median(np.sqrt(C[:, 0, 0] + C[:, 1, 1])))
        worst.append(np.abs(errors(simulation, result)[:, :2]).max())
    assert 0.4 < np.mean(values) < 1.8
    assert np.median(sigmas) < 0.03
    assert max(worst) < 0.12


@pytest.mark.parametrize("name", SMALL_WORLDS)
def test_nearly_all_scans_are_matched(name):
    simulation, mapper, result = run(name)
    n = mapper.counts
    assert n.failed == 0
    assert n.matched > 0.7 * n.offered
    assert n.matched / n.keys > 3.0
    assert n.nis / n.degrees < 1.3  # the noise that is reckoned with is that of the log
    odometry = np.vstack([block.odometry for block in simulation.blocks()])
    raw = ate(simulation.stamps_ns, odometry, simulation.stamps_ns, simulation.truth).rmse
    got = ate(
        simulation.stamps_ns, result.trajectory.poses, simulation.stamps_ns, simulation.truth
    ).rmse
    assert got < 0.5 * raw
    assert got < 0.05


@pytest.mark.parametrize("name", SMALL_WORLDS)
def test_every_scan_has_a_pose_and_a_covariance(name):
    simulation, mapper, result = run(name)
    t = result.trajectory
    assert np.array_equal(t.stamps_ns, simulation.stamps_ns)
    assert mapper.counts.keys == len(mapper.trail.key_at)
    assert mapper.trail.key_at == sorted(set(mapper.trail.key_at))
    assert np.isfinite(t.poses).all()
    assert not t.poses[0].any()
    assert np.array_equal(t.covariances, t.covariances.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(t.covariances).min() > -1e-12


def test_even_walls_are_found_to_be_even():
    """The walls of a simulation are lines, whatever the configuration thinks of real ones."""
    for seed in SEEDS:
        _, mapper, _ = run("room", seed=seed)
        assert mapper.noise.walls < 0.1
        assert mapper.noise.laser == pytest.approx(1.0, abs=0.25)


def test_a_laser_with_more_noise_than_stated_is_found_out():
    loud = simulate(
        world("room", laser={"sigma": 0.017}), np.random.default_rng(1)
    )  # the configuration says 0.01
    mapper, _ = filtered(cut(loud.blocks(), 60))
    assert mapper.noise.laser == pytest.approx(1.7**2, rel=0.25)


def test_wheels_that_slip_more_are_found_out():
    names = [name for name in type(Config().odometry).model_fields if name.startswith("sigma_")]
    stated = Config().odometry
    slipping = {name: 2.5 * getattr(stated, name) for name in names}
    usual = {name: getattr(stated, name) for name in names}
    factors = []
    for sigmas in (usual, slipping):
        simulation = simulate(world("room", odometry=sigmas), np.random.default_rng(2))
        mapper, _ = filtered(cut(simulation.blocks(), 160))
        factors.append(mapper.noise.odometry)
    assert 0.5 < factors[0] < 2.0
    assert factors[1] > 2.0 * factors[0]


def test_figures_are_taken_as_they_are_where_nothing_is_to_be_learnt():
    _, blocks = log_of("room")
    mapper, _ = filtered(cut(blocks, 40), NO_LEARNING)
    assert mapper.noise == (1.0, 1.0, 1.0)


# --- the same again ---


def everything(mapper, result):
    t = result.trajectory
    out = [t.stamps_ns, t.poses, t.covariances]
    for area in mapper.areas:
        out += [area.V.poses, area.V.parameters, area.V.covariance, *area.features]
    return [np.ascontiguousarray(x).tobytes() for x in out]


def test_two_runs_give_the_same_bytes():
    _, blocks = log_of("room_corridor")
    one, other = (everything(*filtered(cut(blocks, 150))) for _ in range(2))
    assert one == other


def test_blocks_are_a_matter_of_reading_only():
    """Where the noise is not learnt from the first of them."""
    simulation, blocks = log_of("room")
    pieces = (cut(blocks, 111), cut(simulation.blocks(37), 111))
    one, other = (everything(*filtered(piece, NO_LEARNING)) for piece in pieces)
    assert one == other


def test_blocks_are_gone_through_once_and_counted():
    simulation, _ = log_of("room")
    counted = []
    blocks = iter(cut(simulation.blocks(10), 75))
    config = Config(noise=NoiseConfig(warm_up=20))
    mapper, seconds = run_filter(blocks, config, counted.append)
    assert next(blocks, None) is None
    assert counted == [10] * 7 + [5]
    assert mapper.trail.stamps_ns == simulation.stamps_ns[:75].tolist()
    assert all(value >= 0.0 for value in seconds.values())


def test_progress_is_told_within_a_block():
    simulation, _ = log_of("room")
    counted = []
    run_filter(iter([next(simulation.blocks(75))]), Config(), counted.append)
    assert counted == [TOLD_EVERY, TOLD_EVERY, 75 - 2 * TOLD_EVERY]


# --- what goes wrong ---


def spoilt(blocks, scans, ranges):
    """The log with other ranges in some scans."""
    out, first = [], 0
    for block in blocks:
        inside = np.array([k for k in scans if first <= k < first + len(block)], dtype=int)
        changed = block.ranges.copy()
        changed[inside - first] = ranges
        out.append(replace(block, ranges=changed))
        first += len(block)
    return out


def slanted_square(laser, half=2.4, turned=0.25 * np.pi):
    """Ranges (beams,) from the middle of a square room."""
    angles = laser.angles() - turned
    nearest = np.abs(np.mod(angles + 0.25 * np.pi, 0.5 * np.pi) - 0.25 * np.pi)
    return (half / np.cos(nearest)).astype(np.float32)


def test_a_scan_that_matches_nothing_is_reported_and_not_forced():
    """One scan of a square that stands across: the robot goes on by odometry, and the map holds."""
    simulation, blocks = log_of("room")
    # A key scan in the middle of a straight stretch, in the frame in which walls are axes.
    _, mapper, _ = run("room")
    keys = [k for k in mapper.trail.key_at if 60 < k < 150]
    heading = simulation.truth[:, 2]
    k = min(keys, key=lambda k: abs(np.sin(2.0 * heading[k])))
    first = blocks[0]
    strange = spoilt(blocks, [k], slanted_square(first.laser))
    mapper, result = filtered(cut(strange, k + 30))
    failed = [e for e in mapper.events if e.kind == "matching_failed"]
    assert [e.stamp_ns for e in failed] == [int(simulation.stamps_ns[k])]
    assert mapper.counts.failed == 1
    # Where the robot is then is what odometry says from the key scan before.
    before = max(i for i in mapper.trail.key_at if i < k)
    odometry = np.vstack([block.odometry for block in blocks])
    step = se2.between(odometry[before], odometry[k])
    told = se2.between(mapper.trail.poses[before], mapper.trail.poses[k])
    assert told == pytest.approx(step, abs=0.02)
    C = [np.trace(mapper.trail.covariances[i]) for i in (before, k)]
    assert C[1] > C[0]
    assert np.abs(errors(simulation, result)[:, :2]).max() < 0.12


def test_scans_that_say_nothing_leave_the_robot_to_its_wheels():
    """Two seconds of a blinded laser: no failure to match is claimed where nothing was seen."""
    simulation, blocks = log_of("room")
    blind = spoilt(blocks, range(100, 108), np.float32(np.nan))
    mapper, result = filtered(cut(blind, 150))
    assert mapper.counts.failed == 0
    assert len(result.trajectory.stamps_ns) == 150
    assert np.abs(errors(simulation, result)[:, :2]).max() < 0.15


def test_a_log_without_a_single_segment_is_its_odometry():
    _, blocks = log_of("room", noiseless=True)
    nothing = [replace(b, ranges=np.full_like(b.ranges, np.inf)) for b in blocks]
    mapper, result = filtered(nothing)
    odometry = np.vstack([block.odometry for block in blocks])
    assert result.trajectory.poses == pytest.approx(se2.between(odometry[0], odometry), abs=1e-9)
    assert len(mapper.area.features.uid) == 0
    sigma = np.sqrt(result.trajectory.covariances[:, 0, 0])
    assert sigma[-1] > sigma[len(sigma) // 2] > 0.0


@pytest.mark.parametrize("duration", [0.0, 2.0])
def test_the_accident_of_the_paper_ends_well(duration):
    """Between stops 5 and 6 the wheels tell of 40 cm and 5 degrees that were not driven, at once
    or within two seconds."""
    bend = {"after": 4, "bend": (0.4, 0.0, 0.0873), "duration": duration}
    base = load_world(DATASETS / "room.yaml").spec.model_dump()
    base["odometry"]["bends"] = [bend]
    simulation = simulate(world_of(base), np.random.default_rng(1))
    odometry = np.vstack([block.odometry for block in simulation.blocks()])
    raw = np.hypot(*(odometry - se2.between(simulation.truth[0], simulation.truth))[-1, :2])
    assert raw > 0.2
    _, result = filtered(simulation.blocks())
    off = np.hypot(*errors(simulation, result)[:, :2].T)
    assert np.median(off) < 0.06
    assert off[-40:].max() < 0.12
    assert np.abs(errors(simulation, result)[-40:, 2]).max() < 0.05


def test_odometry_that_jumps_away_is_not_believed():
    """50 metres between two scans, and again: each time it is reported, and the map goes on."""
    simulation, blocks = log_of("room")
    jumped, first = [], 0
    for block in blocks:
        index = first + np.arange(len(block))
        jump = 50.0 * (index >= 90) - 80.0 * (index >= 140)
        odometry = block.odometry.copy()
        odometry[:, 0] += jump
        jumped.append(replace(block, odometry=odometry))
        first += len(block)
    mapper, result = filtered(cut(jumped, 190))
    failures = [e.stamp_ns for e in mapper.events if e.kind == "odometry_failed"]
    assert failures == simulation.stamps_ns[[90, 140]].tolist()
    off = np.hypot(*errors(simulation, result)[:, :2].T)
    assert off.max() < 0.2
    assert off[-30:].max() < 0.1
    assert mapper.counts.failed == 0
    path = np.hypot(*np.diff(result.trajectory.poses[:, :2], axis=0).T)
    assert path.max() < 0.4


def test_a_door_is_gone_through_and_back():
    """Two areas by one door: out and back is a new area and the old one again."""
    there_and_back = [[1.0, 2.0], [8.5, 2.0], [1.0, 2.0]]
    simulation = simulate(
        world_of(TWO_ROOMS, way_points=there_and_back), np.random.default_rng(1), noiseless=True
    )
    mapper, result = filtered(simulation.blocks())
    assert [k for k in kinds(mapper) if k.startswith("area")] == [
        "area_entered",
        "area_entered",
        "area_reentered",
    ]
    assert len(mapper.areas) == 2
    assert mapper.current == 0
    assert np.abs(errors(simulation, result)).max() < 1e-4


def test_the_end_of_the_log_is_where_the_robot_is():
    """The last scans, too near for the filter, move the robot of the levels as well."""
    simulation, mapper, result = run("room")
    t, robot = result.trajectory, result.model.environment.robot
    assert robot.mean == pytest.approx(t.poses[-1], abs=1e-9)
    assert robot.covariance == pytest.approx(t.covariances[-1], rel=1e-3)
    assert len(mapper.trail.stamps_ns) == len(simulation.stamps_ns)


def test_a_mapper_without_a_scan_has_nothing_to_finish():
    mapper = Mapper(Config())
    mapper.finish()
    assert mapper.areas == []
    assert mapper.trail.stamps_ns == []


# --- many drives ---


@pytest.mark.slow
def test_fifty_drives_around_the_room_are_honest():
    """`nees_robot` and `nees_landmarks` between 0.7 and 1.5, a median sigma below 3 cm."""
    robots, landmarks, sigmas = [], [], []
    for seed in range(50):
        simulation = simulate(world("room"), np.random.default_rng(seed))
        result = map_log(simulation.blocks(), Config())
        t, truth = result.trajectory, (simulation.stamps_ns, simulation.truth)
        robots.append(robot_nees(t, *truth).mean)
        R_t_g = first_pose_alignment(t.stamps_ns, t.poses, *truth)
        assert R_t_g is not None
        best = ate(t.stamps_ns, t.poses, *truth).alignment
        nees = landmark_nees(result.model, simulation.reference_map, R_t_g, best)
        assert nees.n > 0
        landmarks.append(nees.mean)
        sigmas.append(np.median(np.sqrt(t.covariances[:, 0, 0] + t.covariances[:, 1, 1])))
    assert 0.7 < np.mean(robots) < 1.5
    assert 0.7 < np.mean(landmarks) < 1.5
    assert np.median(sigmas) < 0.03
