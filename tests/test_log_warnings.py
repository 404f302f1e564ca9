"""What `run` and `inspect` warn of, shown on logs that have just that fault."""

from __future__ import annotations

import math
from dataclasses import replace

import log_cases as cases
import numpy as np
import pytest
import room_case as room
from real_data import DATA

from hiermap_cli.config import InputConfig
from hiermap_cli.geometry.se2 import between, compose
from hiermap_cli.logs.audit import audit
from hiermap_cli.logs.clock_check import ClockCheck
from hiermap_cli.logs.mcap_writer import RosMcapWriter
from hiermap_cli.logs.odometry_check import OdometryCheck
from hiermap_cli.logs.recording import open_recording
from hiermap_cli.logs.records import Mount, Odometry

SECOND = room.SECOND


def warnings(path, **options):
    recording = open_recording([path], InputConfig(**options))
    for _ in recording.blocks():
        pass
    return recording.report().warnings


def test_a_sound_log_gives_no_warning(tmp_path):
    assert warnings(room.write(tmp_path / "x.mcap")) == ()


@pytest.mark.parametrize(
    "mount", [Mount(0.2, 0.1, 0.3), Mount(0.1, 0.0, math.pi), Mount(0.0, 0.0, 0.5, flipped=True)]
)
def test_a_mount_that_is_stated_rightly_gives_no_contradiction(tmp_path, mount):
    found = warnings(room.write(tmp_path / "x.mcap", real=mount, stated=mount))
    assert not any("wrong way" in text for text in found)
    assert any("rear" in text for text in found) == (abs(mount.yaw) > 2.0)
    assert any("upside down" in text for text in found) == mount.flipped


def test_a_mirrored_laser_shows_in_the_turns(tmp_path):
    path = room.write(tmp_path / "x.mcap", real=Mount(flipped=True))
    assert any("seems mirrored" in text for text in warnings(path))


def test_a_rear_laser_shows_when_driving(tmp_path):
    path = room.write(tmp_path / "x.mcap", real=Mount(yaw=math.pi))
    assert any("seems to look to the rear" in text for text in warnings(path))


def arcs(step):
    """Poses (N, 3) of a robot that never turns on the spot: bends one way and the other."""
    poses = [np.array([2.5, 1.5, 0.1])]
    for i in range(120):
        turn = step * (0.9 if (i * step) % 1.4 < 0.9 else -0.5)
        poses.append(compose(poses[-1], np.array([step * math.cos(0.5 * turn), 0.0, turn])))
        if not inside(poses[-1]):
            poses[-1] = poses[-2] + np.array([0.0, 0.0, 0.3])
    return np.array(poses)


def inside(pose):
    return 1.0 < pose[0] < 5.5 and 0.8 < pose[1] < 4.2


@pytest.mark.parametrize("step", [0.1, 0.7])
@pytest.mark.parametrize(
    ("real", "parts"),
    [
        (Mount(), []),
        (Mount(flipped=True), ["seems mirrored"]),
        (Mount(yaw=math.pi), ["to the rear"]),
        (Mount(yaw=math.pi, flipped=True), ["seems mirrored", "to the rear"]),
    ],
)
def test_a_wrong_mount_shows_in_bends_and_in_scans_far_apart(tmp_path, step, real, parts):
    found = warnings(room.write(tmp_path / "x.mcap", real=real, poses=arcs(step)))
    said = [text for text in found if "wrong way" in text]
    assert len(said) == len(parts)
    assert all(part in text for part, text in zip(parts, said, strict=True))


def unsigned(poses):
    """Odometry whose translation has lost its sign."""
    steps = between(poses[:-1], poses[1:])
    steps[:, 0] = np.abs(steps[:, 0])
    out = [np.zeros(3)]
    for step in steps:
        out.append(compose(out[-1], step))
    return np.array(out)


def test_a_lost_sign_shows_in_odometry_and_in_the_scans(tmp_path):
    path = room.write(tmp_path / "x.mcap", odometry=unsigned(room.drive()))
    found = warnings(path)
    (text,) = [text for text in found if "backing up" in text or "never goes backwards" in text]
    assert "show the robot backing up" in text  # the surer of the two is said


def test_ranges_in_centimetres_are_said(tmp_path):
    path = room.write(tmp_path / "x.mcap", scale=100.0)
    found = warnings(path)
    assert any("ranges" in text and "centimetres" in text for text in found)
    assert any("stated reach is 3000 m" in text for text in found)


def test_carmen_ranges_in_centimetres_are_kept_and_said(tmp_path):
    path = tmp_path / "log.carmen"
    lines = []
    for line in cases.carmen_text().splitlines():
        words = line.split()
        if words[0] == "FLASER":
            words[2:182] = [str(100 * float(word)) for word in words[2:182]]
        lines.append(" ".join(words))
    path.write_text("\n".join(lines))
    assert any("ranges" in text and "centimetres" in text for text in warnings(path))


def test_odometry_in_centimetres_is_said(tmp_path):
    poses = room.drive()
    path = room.write(tmp_path / "x.mcap", odometry=poses * [100.0, 100.0, 1.0])
    assert any("lengths look like centimetres" in text for text in warnings(path))


def carmen(path, poses):
    lines = [
        f"ODOM {x:.6f} {y:.6f} {theta:.6f} 0 0 0 {i / 5 + 1:.6f} h {i / 5 + 1:.6f}"
        for i, (x, y, theta) in enumerate(poses)
    ]
    scan = "RAWLASER1 0 -1.5 3.0 0.5 50 0.01 0 7 1 2 3 4 5 6 7 0"
    lines += [f"{scan} {i / 5 + 1:.6f} h {i / 5 + 1:.6f}" for i in range(len(poses))]
    lines.sort(key=lambda line: float(line.split()[-1]))
    path.write_text("\n".join(["PARAM robot_frontlaser_offset 0 h 0", *lines, ""]))
    return path


def test_a_heading_in_degrees_is_said(tmp_path):
    poses = room.drive()
    sound = warnings(carmen(tmp_path / "a.log", poses))
    wrong = warnings(carmen(tmp_path / "b.log", poses * [1.0, 1.0, math.degrees(1.0)]))
    assert not any("degrees" in text for text in sound)
    assert any("heading in degrees" in text for text in wrong)


def test_a_jump_of_fifty_metres_is_said_and_survived(tmp_path):
    poses = room.drive()
    told = poses.copy()
    told[60:, 0] += 50.0
    found = warnings(room.write(tmp_path / "x.mcap", odometry=told))
    (text,) = [text for text in found if "jumps" in text]
    assert "jumps once" in text
    assert "50.0" in text


def test_odometry_that_stands_still_is_said(tmp_path):
    poses = room.drive()
    found = warnings(room.write(tmp_path / "x.mcap", odometry=np.zeros_like(poses)))
    assert any("does not move" in text for text in found)


def feed(check, poses, step_ns=SECOND // 10):
    for i, (x, y, theta) in enumerate(poses):
        check.add(SECOND + i * step_ns, x, y, theta)
    return check.warnings()


def test_odometry_is_watched_alike_in_any_number_of_batches(monkeypatch):
    poses = [(0.05 * i + (0.6 if i > 500 else 0.0), 0.0, 0.0) for i in range(1000)]
    whole, parts = OdometryCheck(), OdometryCheck()
    expected = feed(whole, poses)
    monkeypatch.setattr("hiermap_cli.logs.odometry_check.BATCH", 17)
    assert feed(parts, poses) == expected
    assert parts.path == pytest.approx(whole.path)
    assert parts.readings == whole.readings == 1000
    assert any("jumps once" in text for text in expected)


def test_steps_to_the_side_are_said_unless_the_robot_always_makes_them():
    ahead = [(0.05 * i, 0.2 * (i > 300), 0.0) for i in range(600)]
    assert any("sideways once" in text for text in feed(OdometryCheck(), ahead))
    crab = [(0.0, 0.3 * i, 0.0) for i in range(600)]
    assert not any("sideways" in text for text in feed(OdometryCheck(), crab, SECOND))


def test_silence_of_odometry_is_said():
    check = OdometryCheck()
    for i in range(300):
        check.add(i * SECOND // 10 + (9 * SECOND if i > 200 else 0), 0.01 * i, 0.0, 0.1 * i)
    assert any("odometry is silent for 9.1 s" in text for text in check.warnings())


@pytest.mark.parametrize("one_epoch", [True, False])
def test_clocks_that_disagree_are_said(one_epoch):
    check = ClockCheck(one_epoch=one_epoch)
    for i in range(9000):
        check.add(i * SECOND, i * SECOND + 3600 * SECOND)
    found = check.warnings()
    assert any("3600.0 s behind" in text for text in found) == one_epoch
    drift = ClockCheck(one_epoch=one_epoch)
    for i in range(9000):
        drift.add(i * SECOND, int(i * SECOND * 1.001))
    assert any("drift apart by" in text for text in drift.warnings())


@pytest.mark.skipif(not DATA.exists(), reason="the real logs are not here")
@pytest.mark.parametrize(
    ("log", "parts"),
    [
        ("fr079", ["--mount"]),
        ("fr079_unsigned", ["--mount", "backing up"]),
        ("csail", ["--mount", "jumps", "sideways", "sign of reverse motion is lost"]),
        ("aces", ["--mount", "jumps", "no scan for 37.7 s"]),
    ],
)
def test_the_known_faults_of_real_logs_are_said_and_no_others(log, parts):
    found = warnings(DATA / log / "log.carmen.gz")
    for part in parts:
        assert any(part in text for text in found), part
    # Either the scans tell that the sign is lost, or the odometry that it may be.
    assert sum("sign of reverse motion" in text for text in found) <= 1
    if log == "fr079":
        assert len(found) == 1


@pytest.mark.skipif(not DATA.exists(), reason="the real logs are not here")
@pytest.mark.parametrize(
    "log",
    ["fr079/log.carmen.gz", "csail/log.carmen.gz", "aces/log.carmen.gz", "wean/robotdata1.log.gz"],
)
@pytest.mark.parametrize(
    ("mirrored", "yaw", "part"),
    [(True, 0.0, "seems mirrored"), (False, math.pi, "seems to look to the rear")],
)
def test_real_logs_with_a_wrong_mount_are_said(tmp_path, log, mirrored, yaw, part):
    recording = open_recording([DATA / log], InputConfig())
    stated = replace(recording.mount, yaw=recording.mount.yaw + yaw)
    with RosMcapWriter(tmp_path / "x.mcap", stated) as writer:
        for timed in recording.ordered():
            value = timed.value
            if isinstance(value, Odometry):
                writer.odometry(timed.time_ns, (value.x, value.y, value.theta))
            else:
                ranges = value.ranges[::-1] if mirrored else value.ranges
                writer.scan(timed.time_ns, ranges, value.laser)
    said = [text for text in warnings(tmp_path / "x.mcap") if "wrong way" in text]
    assert len(said) == 1
    assert part in said[0]


def test_inspect_says_what_run_says(tmp_path):
    path = room.write(tmp_path / "x.mcap", real=Mount(yaw=math.pi))
    assert audit([path], InputConfig()).warnings == warnings(path)
