"""Segments of noiseless scans: exact lines, whole walls, and ends that are what they seem."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scan_cases import COARSE, FULL, HALF, ROOM, block, cast, in_world, line_errors, scans

from hiermap_cli.config import LaserConfig, SegmentationConfig
from hiermap_cli.geometry.lines import hesse_from_points, intersect
from hiermap_cli.logs.records import LaserGeometry, Mount
from hiermap_cli.perception.segmentation import segment_block
from hiermap_cli.perception.segments import END_FREE, END_OPEN, END_VERTEX

LASER, CONFIG = LaserConfig(), SegmentationConfig()
POSES = [(4.0, 3.0, -0.5), (1.0, 3.3, 0.2), (3.6, 0.7, 2.0), (5.0, 2.0, 0.1), (1.2, 0.4, 1.3)]
MOUNTS = [
    Mount(),
    Mount(0.25, -0.1, 0.7),
    Mount(0.0, 0.05, -1.5, flipped=True),
    Mount(-0.2, 0.0, np.pi, flipped=False),
]
REVERSED = LaserGeometry(np.pi / 2, -np.radians(0.5), 361, 0.02, 80.0)
LASERS = [HALF, COARSE, FULL, REVERSED]


def segments(ranges, laser=HALF, mount=None, config=CONFIG):
    return segment_block(block(ranges, laser, mount), LASER, config)


def wall_ahead(laser=HALF, y1=-1.5, y2=1.5, x=3.0):
    return cast([(x, y1, x, y2)], (0.0, 0.0, 0.0), laser.angles())[None]


def turned(alpha):
    return (alpha + np.pi) % (2 * np.pi) - np.pi


@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize("laser", LASERS)
def test_lines_of_noiseless_scans_are_exact(laser, mount):
    found = segments(scans(ROOM, POSES, laser, mount), laser, mount)
    assert set(found.scan) == set(range(len(POSES)))
    turn, off = line_errors(found, POSES, ROOM)
    assert np.abs(turn).max() < 3e-6
    assert np.abs(off).max() < 3e-6
    n = np.stack((np.cos(found.alpha), np.sin(found.alpha)), axis=1)
    for p in (found.p1, found.p2, found.centre):
        np.testing.assert_allclose((n * p).sum(axis=1), found.d, atol=1e-9)
    np.testing.assert_allclose(found.length, np.hypot(*(found.p2 - found.p1).T), atol=1e-12)


@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize("laser", LASERS)
def test_the_material_is_on_the_right(laser, mount):
    found = segments(scans(ROOM, POSES, laser, mount), laser, mount)
    normal = hesse_from_points(found.p1, found.p2)[:, 0]
    np.testing.assert_allclose(turned(found.alpha - normal), 0.0, atol=1e-9)
    # The laser is on the free side: its own distance along the normal is less than the line's.
    seen_from = np.cos(found.alpha) * mount.x + np.sin(found.alpha) * mount.y
    assert (found.d > seen_from).all()


@pytest.mark.parametrize("laser", LASERS)
def test_beams_name_the_ends(laser):
    mount = Mount(0.1, 0.2, 0.3, flipped=True)
    ranges = scans(ROOM, POSES, laser, mount)
    found = segments(ranges, laser, mount)
    for p, beam, kind in (
        (found.p1, found.first_beam, found.end1),
        (found.p2, found.last_beam, found.end2),
    ):
        cut = kind == END_OPEN
        angle = mount.yaw - laser.angles()[beam]
        r = ranges[found.scan, beam]
        point = np.stack((mount.x + r * np.cos(angle), mount.y + r * np.sin(angle)), axis=1)
        np.testing.assert_allclose(point[cut], p[cut], atol=1e-4)


def test_a_corner_is_where_its_walls_meet():
    poses = [(1.0 + 0.37 * i, 1.9 + 0.2 * np.sin(i), 0.9 * i) for i in range(12)]
    room = [(0, 0, 6, 0), (6, 0, 6, 4), (6, 4, 0, 4), (0, 4, 0, 0)]
    found = segments(scans(room, poses, FULL), FULL)
    assert (np.bincount(found.scan) == 4).all()
    assert (found.end1 == END_VERTEX).all()
    assert (found.end2 == END_VERTEX).all()
    _, _, centre, alpha = in_world(found, poses)
    lines = np.stack((alpha, (np.stack((np.cos(alpha), np.sin(alpha)), 1) * centre).sum(1)), 1)
    following = np.arange(len(lines)).reshape(-1, 4)
    corners = intersect(lines, lines[np.roll(following, -1, axis=1).ravel()])
    true = np.array(room, dtype=float)[:, :2]
    miss = np.hypot(*(corners[:, None] - true).transpose(2, 0, 1)).min(axis=1)
    assert miss.max() < 1e-5


def test_a_wall_across_the_seam_is_one():
    room = [(0, 0, 6, 0), (6, 0, 6, 4), (6, 4, 0, 4), (0, 4, 0, 0)]
    for heading in np.linspace(-np.pi, np.pi, 23):
        found = segments(scans(room, [(2.0, 2.2, heading)], FULL), FULL)
        assert len(found.scan) == 4
        np.testing.assert_allclose(sorted(np.round(found.length)), [4, 4, 6, 6])


def test_the_order_is_by_scan_and_by_beam():
    found = segments(scans(ROOM, POSES))
    assert (np.diff(found.scan) >= 0).all()
    same = np.diff(found.scan) == 0
    assert (np.diff(found.first_beam)[same] > 0).all()


def test_jambs_are_free_and_what_is_behind_them_is_cut():
    found = segments(scans(ROOM, [(4.0, 2.0, 0.0)]))
    p1, p2, _, _ = in_world(found, [(4.0, 2.0, 0.0)])
    kinds = {
        (round(float(x)), round(float(y), 1)): kind
        for p, end in ((p1, found.end1), (p2, found.end2))
        for (x, y), kind in zip(p, end, strict=True)
        if x > 5.5
    }
    assert kinds[6, 1.5] == END_FREE
    assert kinds[6, 2.4] == END_FREE
    assert kinds[6, 0.0] == END_VERTEX
    assert kinds[6, 4.0] == END_VERTEX
    assert {kind for (x, _), kind in kinds.items() if x == 10} == {END_OPEN}


def test_jambs_lie_within_half_a_beam():
    found = segments(scans(ROOM, [(4.0, 2.0, 0.0)]))
    p1, p2, _, _ = in_world(found, [(4.0, 2.0, 0.0)])
    jambs = np.concatenate((p1[found.end1 == END_FREE], p2[found.end2 == END_FREE]))
    jambs = jambs[np.abs(jambs[:, 0] - 6.0) < 0.1]
    assert len(jambs) == 2
    spacing = 2.0 * np.radians(0.5) / np.cos(0.25) ** 2
    np.testing.assert_allclose(sorted(jambs[:, 1]), [1.5, 2.4], atol=0.51 * spacing)


@pytest.mark.parametrize("depth", [0.5, np.inf])
def test_a_door_gap_is_never_closed(depth):
    behind = [(3.0 + depth, -3.0, 3.0 + depth, 3.0)] if np.isfinite(depth) else []
    for width in (0.35, 0.65, 0.9, 1.35):
        walls = [(3.0, -2.0, 3.0, -width / 2), (3.0, width / 2, 3.0, 2.0), *behind]
        config = SegmentationConfig(merge_gap=2.0)
        found = segments(scans(walls, [(0.0, 0.1, 0.0)]), config=config)
        near = np.abs(found.d - 3.0) < 1e-3
        assert near.sum() == 2
        assert list(found.end2[near]) == [END_FREE, END_FREE]
        assert list(found.end1[near]) == [END_FREE, END_FREE]


def test_a_wall_that_ends_over_free_space_is_free_at_both_ends():
    found = segments(wall_ahead())
    assert (found.end1[0], found.end2[0]) == (END_FREE, END_FREE)


def test_a_wall_cut_by_the_field_of_view_is_open():
    found = segments(wall_ahead(y1=-1.5, y2=500.0))
    assert (found.end1[0], found.end2[0]) == (END_FREE, END_OPEN)
    found = segments(cast([(-2.0, 1.0, 8.0, 1.0)], (0, 0, 0), HALF.angles())[None])
    assert (found.end1[0], found.end2[0]) == (END_FREE, END_OPEN)


def test_a_wall_cut_by_the_range_limit_is_open():
    laser = HALF._replace(range_max=5.0)
    ranges = scans([(0.0, 1.0, 40.0, 1.0)], [(0.0, 0.0, 0.0)], laser)
    found = segments(ranges, laser)
    assert found.end1[0] == END_OPEN
    assert found.p1[0, 0] == pytest.approx(np.sqrt(24.0), abs=0.25)


def test_a_wall_cut_by_beams_that_say_nothing_is_open():
    ranges = wall_ahead(y1=-1.5, y2=1.5)
    ranges[0, 190:] = np.nan
    found = segments(ranges)
    assert (found.end1[0], found.end2[0]) == (END_FREE, END_OPEN)


def test_a_wall_behind_something_nearer_is_open():
    walls = [(3.0, -2.0, 3.0, 2.0), (1.5, 0.3, 1.5, 3.0)]
    found = segments(scans(walls, [(0.0, 0.0, 0.0)]))
    far, near = np.argsort(-found.d)
    assert found.end2[far] == END_OPEN
    assert found.end1[near] == END_FREE


@pytest.mark.parametrize("beams", [1, 2, 3])
def test_beams_that_say_nothing_do_not_part_a_wall(beams):
    ranges = wall_ahead()
    ranges[0, 180 : 180 + beams] = np.nan
    assert len(segments(ranges).scan) == 1


def test_something_thin_in_front_does_not_part_a_wall():
    walls = [(3.0, -1.5, 3.0, 1.5), (2.0, 0.0, 2.0, 0.1)]
    ranges = scans(walls, [(0.0, 0.0, 0.0)])
    assert np.round(segments(ranges).length.max(), 1) == 3.0
    parted = segments(ranges, config=SegmentationConfig(merge_gap=0.0))
    assert (np.abs(parted.d - 3.0) < 1e-3).sum() == 2


def test_mixed_pixels_do_not_bend_a_line():
    walls = [(3.0, -1.5, 3.0, 0.2), (4.5, -3.0, 4.5, 3.0)]
    ranges = scans(walls, [(0.0, 0.0, 0.0)])
    edge = np.flatnonzero(ranges[0] < 3.1)[-1] + 1
    ranges[0, edge] = 3.04 / np.cos(HALF.angles()[edge])
    ranges[0, 170] -= 0.2
    ranges[0, 165] += 0.2
    found = segments(ranges)
    turn, off = line_errors(found, [(0.0, 0.0, 0.0)], walls)
    assert np.abs(turn).max() < 3e-6
    assert np.abs(off).max() < 3e-6
    assert found.length[np.abs(found.d - 3.0) < 1e-3].sum() > 1.6


def test_a_shallow_bend_parts_walls_of_a_noiseless_scan():
    walls = [(3.0, -1.5, 3.0, 0.0), (3.0, 0.0, 3.03, 1.5)]
    found = segments(scans(walls, [(0.0, 0.0, 0.0)]))
    assert len(found.scan) == 2
    turn, _ = line_errors(found, [(0.0, 0.0, 0.0)], walls)
    assert np.abs(turn).max() < 3e-6


def test_grazing_walls_stay_whole():
    ranges = cast([(0.5, -1.0, 14.0, -1.0)], (0.0, 0.0, 0.0), HALF.angles())[None]
    found = segments(ranges)
    assert len(found.scan) == 1
    assert found.length[0] > 12.0


@settings(max_examples=25, deadline=None)
@given(
    x=st.floats(0.5, 5.5),
    y=st.floats(1.9, 3.5),
    theta=st.floats(-3.1, 3.1),
    yaw=st.floats(-3.1, 3.1),
    flipped=st.booleans(),
)
def test_the_mount_changes_nothing_in_the_robots_frame(x, y, theta, yaw, flipped):
    plain = segments(scans(ROOM, [(x, y, theta)], FULL), FULL)
    mount = Mount(0.0, 0.0, yaw, flipped)
    mounted = segments(scans(ROOM, [(x, y, theta)], FULL, mount), FULL, mount)
    for found in (plain, mounted):
        turn, off = line_errors(found, [(x, y, theta)], ROOM)
        assert np.abs(turn).max() < 1e-5
        assert np.abs(off).max() < 1e-5
    # Beams fall elsewhere, but every long wall seen by one is seen by the other.
    for one, other in ((plain, mounted), (mounted, plain)):
        turn = np.abs(turned(one.alpha[:, None] - other.alpha))
        same = (turn < 1e-5) & (np.abs(one.d[:, None] - other.d) < 1e-5)
        assert same.any(axis=1)[one.length > 1.0].all()


def test_a_scan_does_not_depend_on_its_block():
    rng = np.random.default_rng(4)
    ranges = scans(ROOM, POSES)
    ranges += 0.01 * rng.standard_normal(ranges.shape)
    whole = segments(ranges)
    for k in range(len(POSES)):
        alone = segments(ranges[k : k + 1])
        for field in dataclasses.fields(whole):
            if field.name != "scan":
                together = getattr(whole, field.name)[whole.scan == k]
                np.testing.assert_allclose(getattr(alone, field.name), together, atol=1e-12)


def test_the_ranges_are_left_alone():
    ranges = np.asarray(scans(ROOM, POSES), dtype=np.float32)
    given_ = ranges.copy()
    ranges.flags.writeable = False
    segments(ranges)
    np.testing.assert_array_equal(ranges, given_)


@pytest.mark.parametrize("laser", [HALF, FULL, LaserGeometry(0.0, 0.1, 3, 0.0, 10.0)])
@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 1.0, 1e6, -1.0])
def test_scans_of_one_value_are_no_fault(laser, value):
    found = segments(np.full((3, laser.beams), value), laser)
    assert np.isfinite(found.alpha).all()


@pytest.mark.parametrize("beams", [1, 2, 5, 361])
def test_no_scans_make_no_segments(beams):
    laser = HALF._replace(beams=beams)
    assert len(segments(np.zeros((0, beams)), laser).scan) == 0
    assert len(segments(np.full((1, beams), np.nan), laser).scan) == 0


@settings(max_examples=60, deadline=None)
@given(
    data=st.data(),
    beams=st.integers(1, 60),
    span=st.floats(0.05, 6.2),
    reach=st.sampled_from([4.0, 0.0, np.inf]),
)
def test_any_ranges_make_valid_segments(data, beams, span, reach):
    laser = LaserGeometry(-span / 2, span / beams, beams, 0.0, reach)
    value = st.one_of(st.floats(0.0, 8.0, width=32), st.sampled_from([np.nan, np.inf]))
    ranges = data.draw(st.lists(st.lists(value, min_size=beams, max_size=beams), max_size=3))
    found = segments(np.array(ranges).reshape(-1, beams), laser)
    assert (found.points >= CONFIG.min_points).all()
    assert np.isfinite(found.covariance).all()
    assert (np.linalg.eigvalsh(found.covariance) > 0.0).all()
    assert (found.end_sigma > 0.0).all()
    assert ((found.first_beam >= 0) & (found.last_beam < beams)).all()


def test_lines_that_meet_beyond_an_opening_make_no_vertex():
    # Both walls end on their common point but 0.7 m apart, and beams between go on far behind.
    walls = [(0.5, -1.3, 5.3, -1.3), (6.0, -1.25, 6.0, 2.0), (10.0, -4.0, 10.0, 2.0)]
    found = segments(scans(walls, [(0.0, 0.0, 0.0)]))
    corridor, end = np.argmin(np.abs(found.d - 1.3)), np.argmin(np.abs(found.d - 6.0))
    assert found.end2[corridor] == END_FREE
    assert found.end1[end] == END_FREE
