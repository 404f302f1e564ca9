"""Whole simulations: blocks, truth, reference map, files, and the worlds of datasets/."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner
from world_cases import DATASETS, ONE_ROOM, SMALL_WORLDS, TWO_ROOMS, world_of

from hiermap_cli.commands.main import cli
from hiermap_cli.config import InputConfig
from hiermap_cli.configfile import parse_yaml
from hiermap_cli.documents.reference import read_reference
from hiermap_cli.documents.tum import read_tum
from hiermap_cli.documents.validate import check_file
from hiermap_cli.geometry.se2 import between, compose
from hiermap_cli.logs.recording import open_recording
from hiermap_cli.simulation.floors import office_floor
from hiermap_cli.simulation.output import FILES, write
from hiermap_cli.simulation.polygons import contains, point_distances
from hiermap_cli.simulation.simulator import simulate
from hiermap_cli.simulation.spec import WorldSpec
from hiermap_cli.simulation.world import build_world, load_world

WORLDS = (*SMALL_WORLDS, "office")


def simulated(name, *, noiseless=False, seed=1):
    world = load_world(DATASETS / f"{name}.yaml")
    return simulate(world, np.random.default_rng(seed), noiseless=noiseless)


def ranges_of(simulation, size=256):
    return np.vstack([block.ranges for block in simulation.blocks(size)])


def points_of(block, truth):
    """End points (n, 2) of the beams in the world frame."""
    assert not block.mount.flipped
    origins = compose(truth, block.mount.pose())
    scan, beam = np.nonzero(np.isfinite(block.ranges))
    angles = origins[scan, 2] + block.laser.angles()[beam]
    directions = np.column_stack((np.cos(angles), np.sin(angles)))
    return origins[scan, :2] + block.ranges[scan, beam, None].astype(float) * directions


# --- blocks ---


@pytest.mark.parametrize("name", SMALL_WORLDS)
def test_without_noise_every_point_lies_on_a_face(name):
    simulation = simulated(name, noiseless=True)
    faces = simulation.world.plan.faces()
    done = 0
    for block in simulation.blocks(100):
        truth = simulation.truth[done : done + len(block)]
        points = points_of(block, truth)[::5]
        assert len(points) > 50 * len(block) // 5
        assert point_distances(points, faces).min(axis=1).max() < 1e-5
        done += len(block)
    assert done == len(simulation.stamps_ns)


def test_without_noise_odometry_is_the_truth():
    simulation = simulated("ring", noiseless=True)
    odometry = np.vstack([block.odometry for block in simulation.blocks()])
    assert np.abs(between(odometry, between(simulation.truth[0], simulation.truth))).max() < 1e-11


def test_one_seed_gives_one_log_and_another_another():
    first, same, other = (simulated("room", seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(first.odometry, same.odometry)
    assert np.array_equal(ranges_of(first), ranges_of(same), equal_nan=True)
    assert not np.array_equal(first.odometry, other.odometry)
    assert np.array_equal(first.truth, other.truth)


def test_blocks_are_the_same_whatever_their_size_and_however_often():
    simulation = simulated("room")
    whole = ranges_of(simulation)
    assert np.array_equal(whole, ranges_of(simulation, 7), equal_nan=True)
    assert np.array_equal(whole, ranges_of(simulation), equal_nan=True)


def test_people_change_ranges_and_not_the_odometry():
    world = load_world(DATASETS / "room.yaml")
    crowd = {"people": {"number": 4}}
    base = world.spec.model_dump()
    crowded = simulate(world_of(base, **crowd), np.random.default_rng(1))
    empty = simulate(world, np.random.default_rng(1))
    assert np.array_equal(crowded.odometry, empty.odometry)
    nearer = ranges_of(crowded) < ranges_of(empty) - 0.1
    assert 0.005 < nearer.mean() < 0.3


def test_ranges_have_the_noise_that_the_world_says():
    base = load_world(DATASETS / "room.yaml").spec.model_dump()
    base["laser"] |= {"sigma": 0.02, "sigma_per_metre": 0.01}
    world = world_of(base)
    exact = ranges_of(simulate(world, np.random.default_rng(1), noiseless=True)).astype(float)
    noisy = ranges_of(simulate(world, np.random.default_rng(1))).astype(float)
    safe = np.isfinite(exact) & (exact < world.laser.range_max - 1.0)
    error = (noisy - exact)[safe] / (0.02 + 0.01 * exact[safe])
    n = np.count_nonzero(safe)
    assert abs(error.mean()) < 5.0 / np.sqrt(n)
    assert error.std() == pytest.approx(1.0, abs=5.0 / np.sqrt(2 * n))


def test_beyond_the_reach_is_inf_and_too_near_is_nan():
    world = world_of(TWO_ROOMS, laser={"range_max": 4.0, "range_min": 1.0, "sigma": 0.0})
    ranges = ranges_of(simulate(world, np.random.default_rng(1), noiseless=True))
    assert np.isinf(ranges).any()
    assert np.isnan(ranges).any()
    finite = ranges[np.isfinite(ranges)]
    assert 1.0 <= finite.min() < finite.max() <= 4.0


@pytest.mark.parametrize(("beams", "step"), [(181, None), (181, 0.0175), (271, -0.01), (2, 0.3)])
def test_a_laser_of_unsaid_angles_looks_ahead(beams, step):
    laser = {"beams": beams, "range_max": 8.0}
    laser |= {} if step is None else {"angle_increment": step}
    geometry = world_of(ONE_ROOM, laser=laser).laser
    angles = geometry.angles()
    assert angles[0] == pytest.approx(-angles[-1])
    assert angles[-1] - angles[0] == pytest.approx((beams - 1) * (step or math.radians(1.0)))
    said = world_of(ONE_ROOM, laser=laser | {"angle_min": 0.0}).laser
    assert said == geometry._replace(angle_min=0.0)


def test_the_stated_mount_may_differ_from_the_true_one():
    laser = {"mount": {"x": 0.2}, "stated_mount": {"x": 0.1}}
    simulation = simulate(world_of(TWO_ROOMS, laser=laser), np.random.default_rng(1))
    assert next(simulation.blocks()).mount.x == 0.1
    assert simulation.world.mount.x == 0.2


def test_every_scan_has_a_reading_at_its_stamp():
    world = world_of(TWO_ROOMS, laser={"rate": 7.0}, odometry={"rate": 10.0})
    simulation = simulate(world, np.random.default_rng(1))
    assert np.array_equal(simulation.odometry_ns[simulation.at_scan], simulation.stamps_ns)
    assert (np.diff(simulation.odometry_ns) > 0).all()
    assert not simulation.odometry[0].any()


def test_arrays_of_a_simulation_cannot_be_changed():
    simulation = simulated("room")
    with pytest.raises(ValueError, match="read-only"):
        simulation.truth[0] = 0.0


def test_scans_of_a_large_floor_come_block_by_block():
    world = office_floor(6, np.random.default_rng(1))
    simulation = simulate(world, np.random.default_rng(1))
    assert len(simulation.stamps_ns) > 8000
    held = simulation.truth.nbytes + simulation.odometry.nbytes
    assert held < 100 * 4 * len(simulation.stamps_ns)  # a scan alone has 1440 bytes
    first = next(simulation.blocks(512))
    assert first.ranges.shape == (512, 360)
    assert np.isfinite(first.ranges).mean() > 0.5


# --- truth and reference ---


@pytest.mark.parametrize("name", WORLDS)
def test_truth_lies_in_visited_areas_or_doors(name):
    simulation = simulated(name)
    reference = simulation.reference_map
    inside = np.zeros(len(simulation.truth), dtype=bool)
    for area in reference.areas:
        here = contains(area.polygon, simulation.truth[:, :2])
        assert here.any() == area.visited
        inside |= here
    for door in simulation.world.plan.doors:
        inside |= contains(door.opening, simulation.truth[:, :2])
    assert inside.all()


def test_the_ring_is_that_of_figure_1():
    reference = simulated("ring").reference_map
    doors = {door.id: (set(door.areas), door.visited) for door in reference.doors}
    assert doors == {
        "P0-1": ({"outside:P0-1", "A1"}, False),
        "P1-2": ({"A1", "A2"}, True),
        "P2-3": ({"A2", "A3"}, True),
        "P3-1": ({"A3", "A1"}, True),
    }
    assert {area.id: area.visited for area in reference.areas} == {
        "A1": True,
        "A2": True,
        "A3": True,
        "outside:P0-1": False,
    }
    for wall in reference.walls.reshape(-1, 2):  # the robot was never outside: inner faces only
        assert 0.0 <= wall[0] <= 16.0 or abs(wall[0] + 0.075) < 1e-9


def test_figure_8_has_eleven_stops_and_more_than_ten_corners():
    world = load_world(DATASETS / "room.yaml")
    assert [p.name for p in world.spec.way_points] == [str(k) for k in range(1, 12)]
    assert all(point.stop > 0.0 for point in world.spec.way_points)
    x = np.array([point.at[0] for point in world.spec.way_points])
    assert (x[[0, 1, 2, 10]] > 6.0).all()  # begins and ends in the right-hand side
    assert (x[5:9] < 4.5).all()  # stops 6 to 9 are in the left-hand side
    ends = np.round(world.plan.walls.reshape(-1, 2), 6)
    assert (np.unique(ends, axis=0, return_counts=True)[1] == 2).sum() >= 20


def test_the_office_floor_is_large_enough():
    simulation = simulated("office")
    reference = simulation.reference_map
    rooms = [area for area in reference.areas if area.kind == "room"]
    assert len(rooms) >= 10
    assert sum(room.visited for room in rooms) >= 10
    doors_of = [sum(room.id in door.areas for door in reference.doors) for room in rooms]
    assert min(doors_of) == 1
    assert sum(n >= 2 for n in doors_of) >= 3
    corridors = np.vstack([a.polygon for a in reference.areas if a.kind == "corridor"])
    width, height = np.ptp(corridors, axis=0) - 2.25  # the middle of the corridor
    assert 2.0 * (width + height) >= 100.0
    assert all(a.visited for a in reference.areas if a.kind == "corridor")


def test_doors_lie_at_the_middle_of_their_walls():
    reference = simulate(world_of(TWO_ROOMS), np.random.default_rng(1)).reference
    door = reference["doors"][0]
    assert door["p1"][0] == door["p2"][0] == 6.0
    assert sorted([door["p1"][1], door["p2"][1]]) == [1.5, 2.5]
    assert reference["areas"][0]["polygon"] == [[0.1, 0.1], [5.9, 0.1], [5.9, 3.9], [0.1, 3.9]]


def test_a_door_is_visited_only_when_it_is_crossed():
    for goal, crossed in (([5.5, 2.0], False), ([6.0, 2.0], False), ([6.5, 2.0], True)):
        world = world_of(TWO_ROOMS, way_points=[[1.0, 2.0], goal])
        reference = simulate(world, np.random.default_rng(1)).reference_map
        assert reference.doors[0].visited == crossed


def test_the_example_of_the_readme_is_a_world():
    text = (DATASETS / "README.md").read_text().split("## A world file")[1]
    example = "\n".join(line[4:] for line in text.splitlines() if line.startswith("    "))
    world = build_world(parse_yaml(example, "README.md", WorldSpec))
    assert len(world.journey.legs) == 2
    assert simulate(world, np.random.default_rng(1)).walks is not None


# --- files ---


def test_written_files_are_read_back_as_they_were(tmp_path):
    simulation = simulated("room")
    told = []
    write(simulation, tmp_path, told.append)
    assert sum(told) == len(simulation.stamps_ns)
    truth = read_tum(tmp_path / "truth.tum")
    assert np.array_equal(truth.stamps_ns, simulation.stamps_ns)
    assert np.allclose(truth.poses, simulation.truth, atol=1e-9)
    assert not check_file(tmp_path / "reference.json").faults
    walls = read_reference(tmp_path / "reference.json").walls
    assert np.array_equal(walls, simulation.reference_map.walls)
    recording = open_recording([tmp_path / "log.mcap"], InputConfig())
    scans = 0
    for read, made in zip(recording.blocks(64), simulation.blocks(64), strict=True):
        assert np.array_equal(read.stamps_ns, made.stamps_ns)
        assert np.array_equal(read.ranges, made.ranges, equal_nan=True)
        assert np.allclose(read.odometry, made.odometry, atol=1e-12)
        assert read.has_odometry.all()
        assert read.mount.x == pytest.approx(made.mount.x)
        assert read.laser.beams == made.laser.beams
        assert read.laser.angle_min == pytest.approx(made.laser.angle_min)
        scans += len(read)
    assert scans == len(simulation.stamps_ns)
    assert recording.report().odometry == len(simulation.odometry_ns)


@pytest.mark.parametrize("name", SMALL_WORLDS)
def test_the_logs_of_datasets_are_made_by_the_command(name, tmp_path):
    arguments = ["simulate", str(DATASETS / f"{name}.yaml"), "-o", str(tmp_path / "a")]
    assert CliRunner().invoke(cli, [*arguments, "--seed", "1", "-q"]).exit_code == 0
    kept, made = DATASETS / name, tmp_path / "a"
    # Numbers, not bytes: the last bit of a sine differs from processor to processor.
    truths = [read_tum(folder / "truth.tum") for folder in (kept, made)]
    assert np.array_equal(truths[0].stamps_ns, truths[1].stamps_ns)
    assert np.allclose(truths[0].poses, truths[1].poses, atol=1e-8)
    assert (kept / "reference.json").read_text() == (made / "reference.json").read_text()
    logs = [open_recording([folder / "log.mcap"], InputConfig()) for folder in (kept, made)]
    for one, other in zip(*(log.blocks() for log in logs), strict=True):
        assert np.array_equal(one.stamps_ns, other.stamps_ns)
        assert np.allclose(one.odometry, other.odometry, atol=1e-8)
        same = np.isclose(one.ranges, other.ranges, atol=1e-5, equal_nan=True)
        assert same.mean() > 0.9999  # a beam along an edge may end before or behind it
    assert (kept / "log.mcap").stat().st_size < 600_000


def test_the_command_writes_the_same_bytes_twice(tmp_path):
    runner = CliRunner()
    for folder in ("a", "b"):
        arguments = ["simulate", str(DATASETS / "room.yaml"), "-o", str(tmp_path / folder)]
        assert runner.invoke(cli, [*arguments, "--seed", "5"]).exit_code == 0
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == sorted(FILES)
    for file in FILES:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_the_command_without_noise(tmp_path):
    runner = CliRunner()
    world = str(DATASETS / "room_corridor.yaml")
    for folder, option in (("a", ["--noiseless"]), ("b", ["--noise", "none", "--seed", "9"])):
        result = runner.invoke(cli, ["simulate", world, "-o", str(tmp_path / folder), *option])
        assert result.exit_code == 0, result.output
        assert "423 scans" in result.stderr
    assert (tmp_path / "a" / "log.mcap").read_bytes() == (tmp_path / "b" / "log.mcap").read_bytes()


def test_the_command_refuses_what_it_must(tmp_path):
    runner = CliRunner()
    world = str(DATASETS / "room.yaml")
    output = ["-o", str(tmp_path / "out")]
    assert runner.invoke(cli, ["simulate", world, *output, "-q"]).exit_code == 0
    again = runner.invoke(cli, ["simulate", world, *output])
    assert again.exit_code == 2
    assert "--force" in again.stderr
    assert runner.invoke(cli, ["simulate", world, *output, "--force", "-q"]).exit_code == 0
    missing = runner.invoke(cli, ["simulate", "no.yaml", "-o", str(tmp_path / "x")])
    assert (missing.exit_code, missing.stderr.count("\n")) == (2, 1)
    bad = tmp_path / "bad.yaml"
    bad.write_text(json.dumps({**TWO_ROOMS, "doors": [], "furniture": [{"box": [5, 1, 7, 2]}]}))
    result = runner.invoke(cli, ["simulate", str(bad), "-o", str(tmp_path / "x")])
    assert result.exit_code == 2
    assert "furniture[0]" in result.stderr
    assert not (tmp_path / "x").exists()
