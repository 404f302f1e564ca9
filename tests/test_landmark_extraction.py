"""Landmarks out of single scans against the truth: positions, and what their covariances say."""

import numpy as np
import pytest
from world_cases import TWO_ROOMS, world_of

from hiermap_cli.config import Config
from hiermap_cli.geometry import se2
from hiermap_cli.logs.records import LaserGeometry, Mount, ScanBlock
from hiermap_cli.perception.kinds import rule_sets
from hiermap_cli.perception.kinds.lineset import scan_lines
from hiermap_cli.perception.kinds.rules import find_groups, pose_covariance, re_express
from hiermap_cli.perception.segmentation import segment_block
from hiermap_cli.perception.views import scan_views
from hiermap_cli.simulation.raycast import RayCaster

CONFIG = Config()
LASER = LaserGeometry(-np.pi, np.radians(1.0), 360, 0.05, 20.0)
FINE = LaserGeometry(-np.pi, np.radians(0.5), 720, 0.05, 20.0)
MIDDLE = np.array([3.0, 2.0, 0.3])  # from where all corners are well seen
POSE = np.array([2.0, 1.5, 0.3])
SCANS = 300
# The inner corners of the first room, and its door's middle on this side of the wall.
CORNERS = np.array([[0.1, 0.1], [5.9, 0.1], [5.9, 3.9], [0.1, 3.9]])
DOOR = np.array([5.9, 2.0])
SPACING = np.radians(1.0) * 5.0  # metres between beams along the door's wall, at most


def scans_at(pose, count, sigma, seed=0, laser=LASER):
    world = world_of(TWO_ROOMS)
    clean = RayCaster(world.plan.faces(), laser, Mount()).ranges(pose[None], None, 0.0)
    noise = np.random.default_rng(seed).standard_normal((count, laser.beams))
    return (clean + sigma * noise).astype(np.float32)


def landmarks_in(ranges, laser=LASER):
    """For each scan its lines, and the landmarks found in them."""
    count = len(ranges)
    block = ScanBlock(
        stamps_ns=np.arange(count) * 100_000_000,
        ranges=ranges,
        odometry=np.zeros((count, 3)),
        has_odometry=np.ones(count, dtype=bool),
        laser=laser,
        mount=Mount(),
    )
    segments = segment_block(block, CONFIG.laser, CONFIG.segmentation)
    for view in scan_views(segments, count):
        lines = scan_lines(view)
        yield lines, find_groups(lines, rule_sets(), CONFIG.landmarks)


def test_a_scan_without_noise_shows_the_corners_and_the_door_where_they_are():
    ((lines, groups),) = landmarks_in(scans_at(POSE, 1, 0.0, laser=FINE), FINE)
    found = {}
    for rule, group in groups:
        R_w_l = se2.compose(POSE, rule.extract(lines, group).pose)
        found.setdefault(group.kind, []).append(R_w_l)
    corners = np.array(found["corner_concave"])[:, :2]
    for true in CORNERS:
        assert np.hypot(*(corners - true).T).min() < 1e-4
    assert len(corners) == 4
    (door,) = found["door"]
    assert np.hypot(*(door[:2] - DOOR)) < SPACING
    assert se2.wrap(door[2] + np.pi / 2) == pytest.approx(0.0, abs=1e-4)  # Y leads out, along x


def test_a_wall_seen_too_flatly_is_not_known_to_reach_the_next():
    """From POSE the beams on the wall along x lie 0.2 m apart where it comes to (5.9, 0.1).

    An edge some centimetres before the other wall would look the same.
    """
    found = 0
    for lines, groups in landmarks_in(scans_at(POSE, SCANS, 0.01)):
        for rule, group in groups:
            at = se2.compose(POSE, rule.extract(lines, group).pose)
            found += group.kind == "corner_concave" and np.hypot(*(at[:2] - CORNERS[1])) < 0.1
    assert found < 0.05 * SCANS


def test_covariances_of_corners_tell_the_truth():
    """With beams near enough to each other that one noisy scan tells that the walls meet."""
    errors = {k: [] for k in range(4)}
    headings = {}
    for lines, groups in landmarks_in(scans_at(MIDDLE, SCANS, 0.01, laser=FINE), FINE):
        for rule, group in groups:
            if group.kind != "corner_concave":
                continue
            at = se2.compose(MIDDLE, rule.extract(lines, group).pose)
            k = int(np.argmin(np.hypot(*(CORNERS - at[:2]).T)))
            # The frame chosen at first sight holds for all later views.
            known = headings.setdefault(k, at[2])
            chosen = re_express(rule, lines, group, known - MIDDLE[2])
            extraction = rule.extract(lines, chosen)
            true = se2.between(
                MIDDLE, np.append(CORNERS[k], 0.5 * np.pi * round(known / np.pi * 2))
            )
            e = extraction.pose - true
            e[2] = se2.wrap(e[2])
            C = pose_covariance(lines, chosen, extraction)
            errors[k].append(e @ np.linalg.solve(C, e) / 3.0)
    for values in errors.values():
        assert len(values) > 0.9 * SCANS
        # 95 % of the mean of 300 x 3 squares lie within 1 +- 0.09; the fit is not exactly linear.
        assert 0.85 < np.mean(values) < 1.25


def test_the_covariance_of_a_door_tells_the_truth_within_the_beam_spacing():
    values = []
    for lines, groups in landmarks_in(scans_at(POSE, SCANS, 0.01, seed=1)):
        for rule, group in groups:
            if group.kind != "door":
                continue
            extraction = rule.extract(lines, group)
            e = extraction.pose - se2.between(POSE, np.append(DOOR, -0.5 * np.pi))
            e[2] = se2.wrap(e[2])
            C = pose_covariance(lines, group, extraction)
            values.append(e @ np.linalg.solve(C, e) / 3.0)
    assert len(values) > 0.9 * SCANS
    # From one place the beams always miss the jambs alike: the error hardly changes.
    assert 0.3 < np.mean(values) < 2.0
