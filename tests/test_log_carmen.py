"""CARMEN's records one by one: angles, mounts, odometry, stamps, lines that are none."""

from __future__ import annotations

import math

import log_cases as cases
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiermap_cli.config import InputConfig
from hiermap_cli.errors import InputError
from hiermap_cli.logs.decimal_table import read_table
from hiermap_cli.logs.recording import open_recording
from hiermap_cli.logs.records import Mount

SECOND = 1_000_000_000


def read(tmp_path, *lines, **options):
    path = tmp_path / "log.carmen"
    path.write_text("\n".join([*lines, ""]))
    recording = open_recording([path], InputConfig(**options))
    return recording, list(recording.blocks())


def flaser(second, beams=4, name="FLASER", laser=(0, 0, 0), robot=(0, 0, 0), value="1.5"):
    values = " ".join([value] * beams)
    poses = " ".join(str(v) for v in (*laser, *robot))
    return f"{name} {beams} {values} {poses} {second}.5 host {second}.5"


def odom(second, x=0.0):
    return f"ODOM {x} 0 0 0 0 0 {second}.0 host {second}.0"


@pytest.mark.parametrize(
    ("beams", "first", "step"),
    [
        (180, -90.0, 1.0),
        (181, -90.0, 1.0),
        (360, -90.0, 0.5),
        (361, -90.0, 0.5),
        (721, -90.0, 0.25),
        (100, -90.0, 1.8),
    ],
)
def test_the_number_of_beams_says_their_angles(tmp_path, beams, first, step):
    _, (block,) = read(tmp_path, *(flaser(i, beams) for i in range(1, 4)))
    angles = np.degrees(block.laser.angles())
    np.testing.assert_allclose(angles, first + step * np.arange(beams), atol=2e-4)


def test_a_long_record_says_its_angles_itself(tmp_path):
    long = "ROBOTLASER1 0 -2.0 4.0 1.0 20.0 0.01 0 5 1 2 3 20 19.99 2 7 8 0 0 0 0 0 0 0 0 0 0 0"
    _, (block,) = read(tmp_path, *(f"{long} {i}.5 host {i}.5" for i in range(1, 4)))
    np.testing.assert_allclose(block.laser.angles(), [-2, -1, 0, 1, 2])
    np.testing.assert_array_equal(block.ranges[0], np.float32([1, 2, 3, np.inf, 19.99]))


def test_a_rear_laser_looks_backward(tmp_path):
    recording, _ = read(tmp_path, *(flaser(i, name="RLASER") for i in range(1, 4)))
    assert recording.scan_topic == "RLASER"
    np.testing.assert_allclose(recording.mount.pose(), [0, 0, math.pi])
    assert any("rear" in warning for warning in recording.plan.warnings)


def test_the_front_laser_goes_before_the_rear_one(tmp_path):
    lines = [flaser(i, name=name) for i in range(1, 5) for name in ("RLASER", "FLASER")]
    recording, (block,) = read(tmp_path, *lines)
    assert recording.scan_topic == "FLASER"
    assert len(block) == 4
    assert read(tmp_path, *lines, scan_topic="RLASER")[0].mount.yaw == pytest.approx(math.pi)


def test_all_of_the_mounts_params_count(tmp_path):
    params = ["offset 0.2", "side_offset -0.1", "angular_offset 0.3"]
    lines = [f"PARAM robot_frontlaser_{param} host 0" for param in params]
    recording, _ = read(tmp_path, *lines, flaser(1), flaser(2))
    assert recording.mount == Mount(0.2, -0.1, 0.3)


def moving(offset, shift=0.0):
    """A robot on a circle; the laser's poses are `offset` ahead, and off by a growing shift."""
    lines = []
    for i in range(1, 30):
        x, y, theta = math.cos(0.1 * i), math.sin(0.1 * i), 0.1 * i + math.pi / 2
        ahead = x + offset * math.cos(theta) + shift * i, y + offset * math.sin(theta), theta
        lines.append(flaser(i, laser=ahead, robot=(x, y, theta)))
    return lines


def test_the_poses_of_the_record_say_the_mount_if_they_stay_the_same(tmp_path):
    recording, (block,) = read(tmp_path, *moving(0.2))
    assert recording.mount == Mount(0.2, 0.0, 0.0)
    np.testing.assert_allclose(block.odometry[0, :2], [math.cos(0.1), math.sin(0.1)], atol=1e-9)


def test_the_poses_of_a_corrected_log_are_no_mount(tmp_path):
    recording, _ = read(tmp_path, *moving(0.2, shift=0.05))
    assert recording.mount == Mount()
    assert any("corrected" in warning for warning in recording.plan.warnings)


def test_odometry_may_be_chosen(tmp_path):
    lines = [line for i in range(1, 5) for line in (odom(i, 9.0), flaser(i, robot=(i, 0, 0)))]
    both, (block,) = read(tmp_path, *lines)
    assert both.odometry_topic == "ODOM+FLASER"
    np.testing.assert_allclose(block.odometry[:, 0], [1, 2, 3, 4])
    only, (block,) = read(tmp_path, *lines, odometry_topic="ODOM")
    assert only.odometry_topic == "ODOM"
    np.testing.assert_allclose(block.odometry[:, 0], 9.0)
    own, (block,) = read(tmp_path, *lines, odometry_topic="FLASER")
    np.testing.assert_allclose(block.odometry[:, 0], [1, 2, 3, 4])
    assert own.report().odometry == 4


def test_a_laser_without_odometry_needs_odom(tmp_path):
    raw = "RAWLASER1 0 -1.5 3.0 1.0 20.0 0.01 0 4 1 2 3 4 0"
    lines = [f"{raw} {i}.5 host {i}.5" for i in range(1, 5)]
    with pytest.raises(InputError, match="no odometry"):
        read(tmp_path, *lines)
    recording, (block,) = read(tmp_path, *lines, *(odom(i, i) for i in range(1, 6)))
    assert recording.odometry_topic == "ODOM"
    # The order of lines is not that of their stamps by some seconds: the stamps are the time.
    assert len(block) == 4


def test_the_first_stamp_is_the_time_to_the_last_digit(tmp_path):
    lines = [
        f"FLASER 2 1 2 0 0 0 0 0 0 {1134864629 + i}.{895182 + i:06d} host {i}.1" for i in range(5)
    ]
    _, (block,) = read(tmp_path, *lines)
    expected = [(1134864629 + i) * SECOND + (895182 + i) * 1000 for i in range(5)]
    assert block.stamps_ns.tolist() == expected


@pytest.mark.parametrize("stamp", ["0", "nan", "x", "7.25"])
def test_without_usable_stamps_the_recorders_are_the_time(tmp_path, stamp):
    lines = [f"FLASER 2 1 2 0 0 0 {i} 0 0 {stamp} host {i}.5" for i in range(1, 9)]
    recording, (block,) = read(tmp_path, *lines)
    assert recording.plan.clock == "log"
    assert block.stamps_ns.tolist() == [i * SECOND + SECOND // 2 for i in range(1, 9)]


@pytest.mark.parametrize("end", ["", " 0.0 host 0.0", " nan host nan", " 5 host 5"])
def test_without_any_stamps_order_is_the_time(tmp_path, end):
    lines = [f"FLASER 2 1 2 0 0 0 {i} 0 0{end}" for i in range(1, 9)]
    recording, (block,) = read(tmp_path, *lines)
    assert recording.plan.clock == "order"
    assert np.diff(block.stamps_ns).tolist() == [SECOND // 10] * 7
    np.testing.assert_allclose(block.odometry[:, 0], range(1, 9))


@pytest.mark.parametrize(
    "line",
    [
        "FLASER 4 1 2 3",
        "FLASER x 1 2 3",
        "FLASER -1 1 2 3 4 0 0 0 0 0 0 5 h 5",
        "FLASER 4 1 2 a 4 0 0 0 0 0 0 5 h 5",
        "FLASER 99999999999 1 2 3 4 0 0 0 0 0 0 5 h 5",
        "FLASER 4 1 2 3 4 0 0 0 0 0 0",
        "ODOM 1 2",
        "ODOM 1 2 x 0 0 0 5 h 5",
        "FLASER",
    ],
)
def test_malformed_lines_are_counted_and_cost_nothing_else(tmp_path, line):
    good = [flaser(i) for i in range(1, 20)]
    recording, (block,) = read(tmp_path, *good[:10], line, *good[10:])
    assert len(block) == 19
    assert recording.report().dropped == {"malformed_line": 1}


def test_the_reach_is_that_of_the_first_scans_that_can_be_read(tmp_path):
    """Beams that see nothing say 29.99 here: told by whole lines, and broken ones between them."""
    far = [flaser(i).replace("1.5 1.5 1.5 1.5", "1.5 29.99 1.5 2.5") for i in range(1, 30)]
    broken = ["FLASER 4 1.5", "FLASER x 1 2 3", *far]
    _, (block,) = read(tmp_path, *broken)
    assert block.laser.range_max == pytest.approx(29.99)
    assert np.isinf(block.ranges[:, 1]).all()
    assert np.isfinite(block.ranges[:, [0, 2, 3]]).all()


def test_lines_that_are_no_records_are_counted(tmp_path):
    lines = [flaser(1), "hello world", "", "# FLASER 4", "WIFI 1 2 3", flaser(2), "\x01\x02"]
    recording, (block,) = read(tmp_path, *lines)
    assert len(block) == 2
    assert recording.report().dropped == {"unknown_record": 3}


def test_parts_follow_each_other_and_their_sha_is_that_of_their_digests(tmp_path):
    import hashlib

    paths = cases.FORMATS["carmen split"](tmp_path)
    digests = [hashlib.sha256(path.read_bytes()).digest() for path in paths]
    recording = open_recording(paths, InputConfig())
    assert recording.report().sha256 == hashlib.sha256(b"".join(digests)).hexdigest()
    assert recording.report().log == "part_0.log and 1 more"
    alone = open_recording(paths[:1], InputConfig()).report()
    assert alone.sha256 == hashlib.sha256(paths[0].read_bytes()).hexdigest()
    assert alone.log == "part_0.log"


short = st.from_regex(r"[0-9]{1,8}|[0-9]{0,4}\.[0-9]{1,3}|[0-9]{1,7}\.", fullmatch=True)


@given(st.lists(st.lists(short, min_size=5, max_size=5), min_size=1, max_size=6))
def test_numbers_read_together_are_those_of_float(rows):
    lines = [("A 5 " + " ".join(row) + " end of line").encode() for row in rows]
    table = read_table(lines, 2, 5)
    assert table is not None
    expected = np.array([[float(text) for text in row] for row in rows], dtype=np.float32)
    np.testing.assert_array_equal(table.values, expected)
    assert [line[end:] for line, end in zip(lines, table.ends, strict=True)] == [
        b" end of line"
    ] * len(rows)


@pytest.mark.parametrize(
    "bad",
    ["-1.0", "1e3", "nan", "1.2.3", ".", "", "123456789", "12345678.", "1 ", "\t1", "1,5", "0x1",
     "1/2", "1:2", "..", "1..", "\0", "\u0661"],
)  # fmt: skip
def test_numbers_that_are_unusual_are_left_to_others(bad):
    lines = [b"A 3 1.5 2.5 3.5 x", f"A 3 1.5 {bad} 3.5 x".encode()]
    assert read_table(lines, 2, 3) is None
    assert read_table(lines[:1], 2, 3) is not None


def test_a_line_with_too_few_words_is_left_to_others():
    assert read_table([b"A 3 1 2", b"A 3 1 2 3 x"], 2, 3) is None
    assert read_table([b"A 3 1 2 3 x", b"A 3 1 2"], 2, 3) is None
