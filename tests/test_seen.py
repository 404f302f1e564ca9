"""Scans that are looked at when they are asked for, with those that will be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scan_cases import ROOM, block, scans

from hiermap_cli.config import Config
from hiermap_cli.estimation.noise import residual_factor
from hiermap_cli.perception import seen as seen_module
from hiermap_cli.perception.seen import SeenBlock, parted
from hiermap_cli.perception.segmentation import segment_block
from hiermap_cli.perception.sight import sights
from hiermap_cli.perception.views import scan_views

MANY = 24
STEP = 0.06  # metres: two of three scans are no key scans
CONFIG = Config()
FILTER_ALONE = CONFIG.model_copy(
    update={"refine": CONFIG.refine.model_copy(update={"enabled": False})}
)


def driven():
    poses = [(1.0 + STEP * k, 2.5, 0.0) for k in range(MANY)]
    noise = 0.01 * np.random.default_rng(3).standard_normal((MANY, 361))
    return replace(block(scans(ROOM, poses) + noise), odometry=np.array(poses))


@pytest.fixture
def looked(monkeypatch):
    """How many scans were segmented at each look."""
    many = []

    def counted(some, laser, config):
        many.append(len(some))
        return segment_block(some, laser, config)

    monkeypatch.setattr(seen_module, "segment_block", counted)
    return many


def same(a, b):
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


@pytest.mark.parametrize("config", [CONFIG, FILTER_ALONE])
def test_a_scan_shows_the_same_however_it_is_asked_for(config):
    one = driven()
    segments = segment_block(one, config.laser, config.segmentation)
    views, spaces = list(scan_views(segments, MANY)), list(sights(one, config.laser))
    for asked in ([0, 1, 2, 3, 23], [7, 5, 7, 0], range(MANY)):
        seen = SeenBlock(one, config)
        assert all(same(seen.view(k), views[k]) for k in asked)
        assert all(same(seen.sight(k), spaces[k]) for k in asked)
    assert same(SeenBlock(one, config).sight(4), spaces[4])


def test_the_key_scans_that_the_odometry_foretells_are_segmented_at_once(looked):
    seen = SeenBlock(driven(), FILTER_ALONE)
    each = int(np.ceil(FILTER_ALONE.filter.key_distance / STEP))
    for k in range(0, MANY, each):
        seen.view(k)
    assert looked == [len(range(0, MANY, each))]


def test_a_wrong_foretelling_costs_one_look_more(looked):
    seen = SeenBlock(driven(), FILTER_ALONE)
    each = int(np.ceil(FILTER_ALONE.filter.key_distance / STEP))
    for k in (*range(0, 3 * each, each), *range(3 * each + 1, MANY, each)):
        seen.view(k)
    assert len(looked) == 2


def test_the_refinement_needs_all_scans(looked):
    SeenBlock(driven(), CONFIG).view(5)
    assert looked == [MANY]


def test_the_noise_is_told_by_all_scans_which_are_segmented_once(looked):
    one = driven()
    seen = SeenBlock(one, FILTER_ALONE)
    fits = segment_block(one, CONFIG.laser, CONFIG.segmentation)
    assert seen.laser_factor() == residual_factor(fits.chi2, fits.points - 2, CONFIG.noise) != 1.0
    assert sum(len(seen.view(k).length) for k in range(MANY)) == len(fits.scan)
    assert looked == [MANY]


def test_a_block_falls_into_parts_in_order():
    one = driven()
    parts = parted(one, FILTER_ALONE, 10)
    assert [len(part.block) for part in parts] == [10, 10, 4]
    for name in ("stamps_ns", "ranges", "odometry", "has_odometry"):
        whole = np.concatenate([getattr(part.block, name) for part in parts])
        assert np.array_equal(whole, getattr(one, name))
