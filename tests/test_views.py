"""What the filter takes of a scan's segments, and the noise that it gives them."""

from __future__ import annotations

import numpy as np
import pytest
from estimation_cases import room, view_from, whole_room
from world_cases import ONE_ROOM, world_of

from hiermap_cli.config import Config, FilterConfig
from hiermap_cli.perception.segmentation import segment_block
from hiermap_cli.perception.views import scan_views, with_noise
from hiermap_cli.simulation.simulator import simulate


def block_of_scans():
    simulation = simulate(world_of(ONE_ROOM), np.random.default_rng(1))
    return next(iter(simulation.blocks(12)))


def test_every_scan_has_a_view_of_its_own_segments():
    block = block_of_scans()
    config = Config()
    segments = segment_block(block, config.laser, config.segmentation)
    views = list(scan_views(segments, len(block)))
    assert len(views) == len(block)
    assert sum(len(view.length) for view in views) == len(segments.scan) > 30
    for i, view in enumerate(views):
        of = segments.scan == i
        assert np.array_equal(view.centre, segments.centre[of])
        assert np.array_equal(view.ends[:, 0], segments.p1[of])
        assert np.array_equal(view.ends[:, 1], segments.p2[of])
        assert np.array_equal(view.end_kind[:, 0], segments.end1[of])
        assert np.array_equal(view.end_kind[:, 1], segments.end2[of])
        assert np.array_equal(view.var_theta, segments.covariance[of, 0, 0])
        assert np.array_equal(view.var_y, segments.covariance[of, 1, 1])


def test_headings_run_from_p1_to_p2_with_the_robot_on_the_left():
    block = block_of_scans()
    config = Config()
    segments = segment_block(block, config.laser, config.segmentation)
    for view in scan_views(segments, len(block)):
        d = view.ends[:, 1] - view.ends[:, 0]
        along = np.column_stack((np.cos(view.theta), np.sin(view.theta)))
        assert (d * along).sum(axis=1) == pytest.approx(view.length, rel=1e-6)
        left = np.column_stack((-along[:, 1], along[:, 0]))
        assert ((-view.centre * left).sum(axis=1) > 0.0).all()


def test_a_scan_without_segments_has_an_empty_view():
    block = block_of_scans()
    config = Config()
    segments = segment_block(block, config.laser, config.segmentation)
    views = list(scan_views(segments, len(block) + 3))
    assert [len(view.length) for view in views[-3:]] == [0, 0, 0]


def test_without_unevenness_the_noise_is_the_lasers():
    view = whole_room(room(), vertices=True)
    even = FilterConfig(wall_sigma=0.0, wall_sigma_theta=0.0, end_sigma=0.0)
    same = with_noise(view, even, 1.0, 1.0)
    for old, new in zip(view, same, strict=True):
        assert new == pytest.approx(old)
    louder = with_noise(view, even, 4.0, 1.0)
    assert louder.var_y == pytest.approx(4.0 * view.var_y)
    assert louder.var_theta == pytest.approx(4.0 * view.var_theta)


def test_walls_that_are_no_lines_add_to_the_lasers_noise():
    config = FilterConfig(wall_sigma=0.02, wall_sigma_theta=0.01, end_sigma=0.03)
    view = view_from(room(), [(0, -0.25, 0.25), (0, -2.0, 2.0)], sigma=0.01, sigma_theta=0.002)
    uneven = with_noise(view, config, 1.0, 2.0)
    assert uneven.var_y == pytest.approx(np.full(2, 0.01**2 + 2 * 0.02**2))
    # The shorter, the less it says of its wall's direction.
    extra = uneven.var_theta - view.var_theta - 2 * 0.01**2
    assert extra == pytest.approx(2 * 0.02**2 / np.array([0.5, 4.0]) ** 2)
    assert uneven.end_sigma == pytest.approx(np.full((2, 2), np.sqrt(0.01**2 + 2 * 0.03**2)))
    for name in ("centre", "theta", "ends", "end_kind", "length"):
        assert getattr(uneven, name) is getattr(view, name)


def test_a_factor_of_zero_is_an_even_wall():
    view = whole_room(room())
    even = with_noise(view, Config().filter, 1.0, 0.0)
    for old, new in zip(view, even, strict=True):
        assert new == pytest.approx(old)
