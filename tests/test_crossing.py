"""Areas and doors of small simulated worlds, from the scans to the rooms."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from estimation_cases import assembled
from world_cases import DATASETS, ROOT, TWO_ROOMS, world_of

from hiermap_cli.config import Config
from hiermap_cli.evaluation.areas import area_metrics, topology_metrics
from hiermap_cli.evaluation.doors import door_metrics
from hiermap_cli.evaluation.placed import place
from hiermap_cli.evaluation.trajectory import ate
from hiermap_cli.mapping.filtering import run_filter
from hiermap_cli.simulation.simulator import simulate
from hiermap_cli.simulation.world import load_world

NO_POSES = np.zeros((0, 3))
FR079 = ROOT.parent / "shared" / "data" / "fr079"


def mapped(world, seed=0):
    simulation = simulate(world, np.random.default_rng(seed))
    mapper, _ = run_filter(simulation.blocks(), Config())
    return simulation, mapper, assembled(mapper)


def judged(simulation, result):
    t = result.trajectory
    fit = ate(t.stamps_ns, t.poses, simulation.stamps_ns, simulation.truth)
    placed = place(result.model, fit.alignment)
    reference = simulation.reference_map
    return (
        area_metrics(placed, reference, NO_POSES),
        door_metrics(placed, reference),
        topology_metrics(placed, reference),
        fit,
    )


def assert_as_in_the_plan(simulation, result):
    areas, doors, topology, _ = judged(simulation, result)
    assert len(areas.matches) == areas.asked == areas.found
    counts = doors.detections
    assert counts.matched == counts.asked == counts.found
    if counts.asked:
        assert topology.precision == topology.recall == 1.0


@pytest.mark.parametrize("name", ["room", "room_corridor"])
@pytest.mark.parametrize("seed", [0, 1])
def test_small_worlds_have_the_areas_and_doors_of_their_plan(name, seed):
    simulation, _, result = mapped(load_world(DATASETS / f"{name}.yaml"), seed)
    assert_as_in_the_plan(simulation, result)


@pytest.mark.parametrize("seed", [0, 3])
def test_the_ring_is_closed_by_another_door(seed):
    simulation, mapper, result = mapped(load_world(DATASETS / "ring.yaml"), seed)
    assert_as_in_the_plan(simulation, result)
    assert judged(simulation, result)[3].max < 0.1
    assert "same" in {p.kind for p in mapper.portals}
    kinds = Counter(event.kind for event in result.events)
    assert kinds["area_recognised"] >= 1
    assert {area.kind for area in result.model.areas} <= {"room", "corridor"}


def test_back_and_forth_through_one_door_is_one_door():
    way = [[1.0, 2.0], [8.0, 2.0], [8.5, 1.0], [8.0, 2.0], [2.0, 2.0], [1.0, 1.0], [2.0, 2.0],
           [8.5, 2.0]]  # fmt: skip
    simulation, mapper, result = mapped(world_of(TWO_ROOMS, way_points=way))
    assert_as_in_the_plan(simulation, result)
    (door,) = result.model.environment.doors
    assert door.crossings == 3
    assert len(mapper.areas) == 2
    assert result.model.areas[1].entered_by == door.id
    assert result.model.areas[0].entered_by is None


def test_every_scan_is_taken_into_one_area_and_grids_do_not_grow_with_time():
    way = [[1.0, 1.0], [5.0, 1.0], [5.0, 3.0], [1.0, 3.0]]
    one = world_of(TWO_ROOMS, way_points=way)
    three = world_of(TWO_ROOMS, way_points=way * 3)
    cells = []
    for world in (one, three):
        _, mapper, _ = mapped(world)
        (grid,) = mapper.crossings.places.grids.values()
        cells.append(grid.passed.size)
    assert cells[1] <= 1.2 * cells[0]


def test_every_candidate_leaves_its_evidence_among_the_events():
    _, mapper, result = mapped(load_world(DATASETS / "ring.yaml"))
    for event in result.events:
        if event.kind == "area_entered" and event.details.get("door"):
            assert {"width", "wall", "open"} <= event.details.keys()
    found = [p for p in mapper.portals if p.kind == "door"]
    assert all(p.wall - p.open > 1.0 for p in found)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_the_office_floor_has_all_its_areas_and_doors(seed):
    simulation, _, result = mapped(load_world(DATASETS / "office.yaml"), seed)
    assert_as_in_the_plan(simulation, result)


@pytest.mark.slow
@pytest.mark.skipif(not FR079.exists(), reason="the real logs are not here")
def test_a_real_floor_has_most_of_its_areas_and_doors():
    from hiermap_cli.documents.reference import read_reference
    from hiermap_cli.documents.tum import read_tum
    from hiermap_cli.logs.recording import open_recording

    recording = open_recording([FR079 / "log.carmen.gz"], Config().input)
    result = assembled(run_filter(recording.blocks(), Config())[0])
    truth = read_tum(FR079 / "slam_reference.tum")
    t = result.trajectory
    fit = ate(t.stamps_ns, t.poses, *truth)
    placed = place(result.model, fit.alignment)
    reference = read_reference(FR079 / "reference.json")
    assert len(area_metrics(placed, reference, NO_POSES).matches) >= 12
    assert door_metrics(placed, reference).detections.matched >= 12
    assert len(result.model.areas) <= 19
