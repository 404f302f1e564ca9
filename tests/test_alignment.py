"""Alignment on the maps alone: found where it is plain, refused where it is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from eval_cases import AREAS, MODEL, REFERENCE, TRACK, write_map
from large_building import boxes, model_of, path_through, reference_of

from hiermap_cli.documents.occupancy import read_map_server
from hiermap_cli.documents.reference import ReferenceMap
from hiermap_cli.evaluation.alignment import align_by_maps
from hiermap_cli.evaluation.evidence import model_points, raster_of_grid, raster_of_reference
from hiermap_cli.evaluation.judge import Given, Run, judge
from hiermap_cli.evaluation.placed import move_points, place
from hiermap_cli.geometry.se2 import compose, wrap

OTHER = reference_of(boxes(2, 6))


def points(model=MODEL, track=TRACK):
    return model_points(place(model, np.zeros(3)), track.poses[:, :2])


def turned(reference: ReferenceMap, pose) -> ReferenceMap:
    return ReferenceMap(
        walls=move_points(pose, reference.walls.reshape(-1, 2)).reshape(-1, 4),
        areas=tuple(replace(a, polygon=move_points(pose, a.polygon)) for a in reference.areas),
    )


@pytest.mark.parametrize(
    "pose", [(0.0, 0.0, 0.0), (30.0, -12.0, 0.6), (-7.3, 4.4, 3.0), (1.0, 2.0, -1.57)]
)
def test_a_reference_in_any_frame_is_found(pose):
    pose = np.array(pose)
    found = align_by_maps(points(), raster_of_reference(turned(REFERENCE, pose)))
    assert found.R_t_g is not None, found.reason
    assert found.R_t_g[:2] == pytest.approx(pose[:2], abs=0.06)
    assert abs(wrap(found.R_t_g[2] - pose[2])) < 0.01
    assert found.best.walls > 0.97
    assert found.second.surprise > 1.33 * found.best.surprise


def test_without_walls_the_outlines_of_areas_are_aligned_with():
    bare = ReferenceMap(areas=turned(REFERENCE, np.array([5.0, 5.0, 1.0])).areas)
    found = align_by_maps(points(), raster_of_reference(bare))
    assert found.R_t_g == pytest.approx([5.0, 5.0, 1.0], abs=0.06)


def test_a_map_of_cells_is_aligned_with(tmp_path):
    grid = read_map_server(write_map(tmp_path))
    pose = np.array([3.0, -2.0, 0.5])
    run = Run(replace(TRACK, poses=compose(pose, TRACK.poses)), moved_model(pose))
    document = judge(run, Given(grid=grid)).document
    values = document.values()
    assert document.details["alignment"]["by"] == "maps"
    # The model's walls run across the eight doors.
    assert values["occupancy_agreement"] > 0.95
    assert values["free_agreement"] > 0.97


def moved_model(pose):
    """The model with its global frame elsewhere."""
    env = MODEL.environment
    areas = tuple((name, replace(e, mean=compose(pose, e.mean))) for name, e in env.areas)
    doors = tuple(
        replace(d, estimate=replace(d.estimate, mean=compose(pose, d.estimate.mean)))
        for d in env.doors
    )
    return replace(MODEL, environment=replace(env, areas=areas, doors=doors))


def test_another_building_is_refused_and_nothing_is_measured():
    areas = boxes(1, 3)
    other = model_of(areas, reference_of(areas))
    found = align_by_maps(points(other, path_through(areas)), raster_of_reference(OTHER))
    assert found.R_t_g is None
    assert "two places fit about as well" in found.reason
    document = judge(Run(path_through(areas), other), Given(reference=OTHER)).document
    assert not {"corner_recall", "door_recall", "area_recall"} & set(document.values())
    assert document.details["alignment"]["pose"] is None
    reasons = {one.name: one.reason for one in document.unmeasured}
    assert reasons["corner_recall"] == found.reason


def test_a_building_that_is_its_own_mirror_by_half_a_turn_is_refused():
    symmetric = {name: (kind, polygon) for name, (kind, polygon) in AREAS.items() if name == "c0"}
    reference = reference_of(symmetric)
    track = path_through(symmetric)
    found = align_by_maps(
        points(model_of(symmetric, reference), track), raster_of_reference(reference)
    )
    assert found.R_t_g is None
    assert "two places fit" in found.reason


def test_maps_that_agree_nowhere_are_refused():
    lines = np.array([[0.0, 0.0, 40.0, 0.0], [0.0, 0.3, 40.0, 9.0]])
    found = align_by_maps(points(), raster_of_reference(ReferenceMap(walls=lines)))
    assert found.R_t_g is None
    assert "is it the same building?" in found.reason


def test_nothing_to_align_by():
    assert raster_of_reference(ReferenceMap()) is None
    assert "neither walls nor areas" in align_by_maps(points(), None).reason
    empty = replace(MODEL, landmarks=())
    assert "hardly any wall" in align_by_maps(points(empty), raster_of_reference(REFERENCE)).reason


def test_the_same_maps_give_the_same_bytes(tmp_path):
    raster = raster_of_grid(read_map_server(write_map(tmp_path)))
    assert np.array_equal(
        align_by_maps(points(), raster).R_t_g, align_by_maps(points(), raster).R_t_g
    )
