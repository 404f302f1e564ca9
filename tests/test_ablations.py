"""What the configuration can leave out of the method is left out, and nothing else."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from estimation_cases import room, view_from
from world_cases import DATASETS

from hiermap_cli.config import AssociationConfig, Config, FilterConfig
from hiermap_cli.mapping.area_map import END
from hiermap_cli.mapping.association.matching import associate
from hiermap_cli.mapping.filtering import run_filter
from hiermap_cli.mapping.run import finish, map_log
from hiermap_cli.perception.segments import END_FREE, END_OPEN, END_VERTEX
from hiermap_cli.perception.views import measured
from hiermap_cli.simulation.simulator import simulate
from hiermap_cli.simulation.world import load_world


@pytest.fixture(scope="module")
def blocks():
    world = load_world(DATASETS / "room_corridor.yaml")
    return list(simulate(world, np.random.default_rng(0)).blocks())


def seen_view():
    kinds = [(END_OPEN, END_OPEN), (END_OPEN, END_FREE), (END_VERTEX, END_OPEN)]
    return view_from(room(), [(0, -2.0, 2.0), (1, -1.0, 1.0), (2, -2.0, 1.0)], kinds)


def test_walls_have_no_ends_to_measure_and_are_else_the_same():
    view = seen_view()
    walls = measured(view, "walls")
    assert (walls.end_kind == END_OPEN).all()
    assert walls._replace(end_kind=view.end_kind) == view
    assert (view.end_kind[1:] != END_OPEN).any()


def test_landmarks_are_segments_that_end():
    view = seen_view()
    shown = measured(view, "landmarks")
    for column, all_of_it in zip(shown, view, strict=True):
        assert np.array_equal(column, all_of_it[1:])
    assert measured(view, "all") is view


def test_without_joint_compatibility_pairs_that_contradict_each_other_pass():
    area = room(sigma=1e-4)
    view = view_from(area, [(0, -2.0, 2.0), (1, -1.5, 1.5), (2, -2.0, 2.0), (3, -1.5, 1.5)])
    # Each wall stands 3.4 sigmas farther away than it should: no pose of the robot explains that.
    normal = np.column_stack((-np.sin(view.theta), np.cos(view.theta)))
    off = -0.034 * normal
    view = view._replace(centre=view.centre + off, ends=view.ends + off[:, None])
    together = associate(area, view, AssociationConfig(), FilterConfig())
    alone = associate(area, view, AssociationConfig(joint=False), FilterConfig())
    assert len(alone.matches.wall) == 4
    assert 0 < len(together.matches.wall) < 4


def test_the_filter_takes_what_is_measured(blocks):
    found = {}
    for features in ("all", "walls", "landmarks"):
        config = Config(filter=FilterConfig(features=features))
        mapper, _ = run_filter(blocks, config)
        ends = sum(int((area.features.kind == END).sum()) for area in mapper.areas)
        found[features] = (ends, mapper.counts.offered)
    assert found["all"][0] > found["walls"][0] == 0
    assert found["landmarks"][0] > 0
    assert found["all"][1] >= found["walls"][1] > found["landmarks"][1] > 0


def test_without_loops_none_is_thought_of(blocks):
    kinds = {True: [], False: []}
    for enabled, told in kinds.items():
        config = Config.model_validate({"loops": {"enabled": enabled}})
        told += [event.kind for event in map_log(blocks, config).events if "loop_" in event.kind]
    assert "loop_closed" in kinds[True]
    assert kinds[False] == []


def test_a_prior_of_zero_is_a_calibration_that_is_known(blocks):
    known = ("prior_scale", "prior_rotation_scale", "prior_curvature", "prior_laser_x")
    config = Config.model_validate({"odometry": dict.fromkeys(known, 0.0)})
    result = map_log(blocks, config)
    told = {metric.name: metric.value for metric in result.metrics}
    for name in ("odometry_scale_translation", "odometry_scale_rotation"):
        assert told[name] == pytest.approx(1.0, abs=1e-5)
    assert told["odometry_curvature"] == pytest.approx(0.0, abs=1e-5)
    assert told["laser_x"] == pytest.approx(blocks[0].mount.x, abs=1e-5)


def test_a_filter_that_was_kept_is_finished_as_if_at_once(blocks):
    """And what concerns loops and refinement alone does not concern the filter."""
    whole = Config.model_validate(
        {"loops": {"min_overlap": 3.0}, "refine": {"match_offset": 0.1, "least_seen": 2}}
    )
    mapper, timing = run_filter(blocks, Config())
    again = pickle.loads(pickle.dumps(mapper))
    again.config = whole
    kept, at_once = finish(again, timing, blocks[0].mount.x), map_log(blocks, whole)
    for name in ("trajectory", "trajectory_filter"):
        assert np.array_equal(getattr(kept, name).poses, getattr(at_once, name).poses)
    assert kept.metrics == at_once.metrics
