"""Recordings in several files: one after the other, in any order, or side by side."""

from __future__ import annotations

import shutil
import sqlite3

import log_cases as cases
import numpy as np
import pytest
from click.testing import CliRunner
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from hiermap_cli.commands.main import cli
from hiermap_cli.config import InputConfig
from hiermap_cli.errors import InputError
from hiermap_cli.logs.recording import open_recording

MESSAGES = [
    (topic, kind, log_ns, bytes(cases.STORE2.serialize_cdr(message, kind)))
    for topic, kind, log_ns, message in cases.ros_messages(cases.STORE2)
]


def write(path, messages, chunk_size=3000):
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=chunk_size, compression=CompressionType.LZ4)
        writer.start("ros2", "tests")
        channels = {}
        for topic, kind, log_ns, data in messages:
            if topic not in channels:
                schema = writer.register_schema(kind, "ros2msg", b"")
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], log_ns, data, log_ns)
        writer.finish()
    return path


def check(paths):
    recording = open_recording(paths, InputConfig())
    (block,) = recording.blocks()
    assert block.stamps_ns.tolist() == cases.stamps()
    expected = np.array([cases.ranges(i) for i in range(cases.SCANS)], dtype=np.float32)
    np.testing.assert_array_equal(block.ranges, expected)
    np.testing.assert_allclose(block.odometry, [cases.pose(t) for t in cases.stamps()], atol=1e-9)
    assert block.mount.x == pytest.approx(cases.MOUNT_X)
    report = recording.report()
    assert (report.scans, report.dropped, report.lost) == (cases.SCANS, {}, ())
    return report


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1)])
def test_parts_are_one_log_in_whatever_order(tmp_path, order):
    third = len(MESSAGES) // 3
    parts = [MESSAGES[:third], MESSAGES[third : 2 * third], MESSAGES[2 * third :]]
    paths = [write(tmp_path / f"p{i}.mcap", part) for i, part in enumerate(parts)]
    report = check([paths[i] for i in order])
    assert report.files == ("p0.mcap", "p1.mcap", "p2.mcap")


def test_recordings_side_by_side_are_merged(tmp_path):
    scans = [m for m in MESSAGES if m[0] == "/scan"]
    others = [m for m in MESSAGES if m[0] != "/scan"]
    check([write(tmp_path / "scans.mcap", scans), write(tmp_path / "others.mcap", others)])


def test_topics_written_one_after_the_other_are_read_by_time(tmp_path):
    messages = sorted(MESSAGES, key=lambda m: m[0])
    assert [m[2] for m in messages] != sorted(m[2] for m in messages)
    check([write(tmp_path / "log.mcap", messages)])
    check([write(tmp_path / "one_chunk.mcap", messages, chunk_size=1 << 22)])


def split_bag(folder):
    """A rosbag2 folder in two files, as its recorder splits them."""
    cases.write_rosbag2(folder)
    first, second = folder / "bag.db3", folder / "bag_1.db3"
    shutil.copy(first, second)
    for path, keep in ((first, "<="), (second, ">")):
        database = sqlite3.connect(path)
        half = len(MESSAGES) // 2
        database.execute(f"DELETE FROM messages WHERE NOT id {keep} {half}")
        database.commit()
        database.close()
    cases.list_more(folder, "bag_1.db3")


def test_a_split_folder_is_one_log(tmp_path):
    folder = tmp_path / "bag"
    split_bag(folder)
    check([folder])
    check([folder / "metadata.yaml"])
    check([folder / "bag.db3", folder / "bag_1.db3"])


def test_an_unclosed_database_is_read_with_its_write_ahead_log(tmp_path):
    folder = tmp_path / "bag"
    cases.write_rosbag2(folder)
    path = folder / "bag.db3"
    database = sqlite3.connect(path)
    database.execute("PRAGMA journal_mode=WAL")
    database.execute("PRAGMA wal_autocheckpoint=0")
    rows = database.execute("SELECT * FROM messages WHERE id > 30").fetchall()
    database.execute("DELETE FROM messages WHERE id > 30")
    database.commit()
    database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    marks = ",".join("?" * len(rows[0]))
    database.executemany(f"INSERT INTO messages VALUES ({marks})", rows)
    database.commit()
    live = tmp_path / "live"
    shutil.copytree(folder, live)  # as a crash leaves it
    database.close()
    assert (live / "bag.db3-wal").stat().st_size > 0
    check([live])


def test_files_of_different_kinds_are_no_recording(tmp_path):
    (text,) = cases.FORMATS["carmen"](tmp_path)
    (mcap,) = cases.FORMATS["mcap zstd"](tmp_path)
    with pytest.raises(InputError, match="no parts of one recording") as caught:
        open_recording([text, mcap], InputConfig())
    assert "log.carmen is text" in str(caught.value)


def test_a_part_that_cannot_be_read_is_said_and_the_others_are(tmp_path):
    half = len(MESSAGES) // 2
    good = write(tmp_path / "a.mcap", MESSAGES[:half])
    bad = tmp_path / "b.mcap"
    bad.write_bytes(b"\x89MCAP0\r\n" + b"\0" * 500)
    recording = open_recording([good, bad], InputConfig())
    (block,) = recording.blocks()
    assert block.stamps_ns.tolist() == cases.stamps()[: len(block)]
    assert any("b.mcap" in loss for loss in recording.report().lost)


def test_a_name_without_an_ending_does_not_matter(tmp_path):
    for kind in ("mcap zstd", "bag", "carmen gzip", "wean"):
        folder = tmp_path / kind
        folder.mkdir()
        (path,) = cases.FORMATS[kind](folder)
        plain = path.rename(folder / "recording")
        assert len(list(open_recording([plain], InputConfig()).blocks())) == 1


# ------------------------------------------------------------- parts that overlap in time


def recorded(message, kind, topic, log_ns):
    return topic, kind, log_ns, bytes(cases.STORE2.serialize_cdr(message, kind))


def odometry(shift):
    """The readings of a robot that drives elsewhere."""
    for stamp_ns in cases.odometry_stamps():
        at = tuple(a + b for a, b in zip(cases.pose(stamp_ns), shift, strict=True))
        message = cases.odometry_message(cases.STORE2, stamp_ns, at)
        yield recorded(message, "nav_msgs/msg/Odometry", "/odom", stamp_ns)


def scans(frame="laser", step=1.0, offset_ns=0):
    for index, stamp_ns in enumerate(cases.stamps()):
        message = cases.scan_message(cases.STORE2, stamp_ns + offset_ns, index)
        message.header.frame_id = frame
        message.angle_increment *= step
        yield recorded(message, "sensor_msgs/msg/LaserScan", "/scan", stamp_ns + 1)


def mounted(x):
    edge = ("base", "laser", (x, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    message = cases.tf_message(cases.STORE2, cases.START, (edge,))
    return recorded(message, "tf2_msgs/msg/TFMessage", "/tf_static", cases.START)


def late(messages, by_ns):
    return [(topic, kind, log_ns + by_ns, data) for topic, kind, log_ns, data in messages]


OTHERS = {
    "metres away": (list(odometry((0.5, 0.0, 0.0))), "odometry is at"),
    "turned": (list(odometry((0.0, 0.0, 0.3))), "odometry is at"),
    "metres away, later": (late(odometry((0.5, 0.0, 0.0)), 40_000_000), "odometry is at"),
    "another frame": (list(scans("rear_laser")), "of the frames laser and rear_laser"),
    "other beams": (list(scans(step=0.5)), "180 beams from -90 degrees and 180 beams"),
    "another mount": ([mounted(0.4), *scans()], "mounted at 0.40,0.00,0.00 and 0.25,0.00,0.00"),
}


@pytest.mark.parametrize("kind", OTHERS)
def test_logs_that_overlap_and_contradict_each_other_are_no_recording(tmp_path, kind):
    messages, fault = OTHERS[kind]
    # One drive's own log, and one that begins before it has ended.
    first, second = write(tmp_path / "a.mcap", MESSAGES), write(tmp_path / "b.mcap", messages)
    for words in (["run", "-o", str(tmp_path / "out")], ["inspect"]):
        result = CliRunner().invoke(cli, [*words, str(first), str(second)])
        assert result.exit_code == 1
        assert fault in result.stderr
        assert all(str(path) in result.stderr for path in (first, second))
        assert "overlap in time and are no parts of one recording" in result.stderr
        assert len(result.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
    with pytest.raises(InputError, match="no parts of one recording"):
        open_recording([second, first], InputConfig())


def test_a_mount_that_is_given_settles_what_the_parts_say(tmp_path):
    first = write(tmp_path / "a.mcap", MESSAGES)
    second = write(tmp_path / "b.mcap", OTHERS["another mount"][0])
    options = InputConfig.model_validate({"mount": {"x": 0.3}})
    assert open_recording([first, second], options).mount.x == 0.3


HALF = len(MESSAGES) // 2
TOGETHER = {
    "a few messages twice": (MESSAGES[: HALF + 6], MESSAGES[HALF - 6 :]),
    "everything twice": (MESSAGES, MESSAGES),
    "part of it once more": (MESSAGES, MESSAGES[HALF : HALF + 9]),
    "two recorders": (MESSAGES[::2], [MESSAGES[0], *late(MESSAGES[1::2], 30_000_000)]),
    "two recorders, one with gaps": (MESSAGES, late(MESSAGES[2::5], 30_000_000)),
    "other readings of one clock": (MESSAGES[1::2], MESSAGES[2::2]),
}


@pytest.mark.parametrize("kind", TOGETHER)
def test_parts_that_overlap_and_agree_are_one_recording(tmp_path, kind):
    paths = [write(tmp_path / f"p{i}.mcap", part) for i, part in enumerate(TOGETHER[kind])]
    recording = open_recording(paths, InputConfig())
    found = list(recording.blocks())
    stamps = np.concatenate([block.stamps_ns for block in found])
    assert sorted(set(stamps.tolist())) == cases.stamps()


@pytest.mark.parametrize("kind", ["mcap zstd", "bag", "rosbag2", "carmen", "carmen gzip", "wean"])
def test_a_log_given_twice_is_read_once(tmp_path, kind):
    paths = cases.FORMATS[kind](tmp_path)
    once = open_recording(paths, InputConfig())
    expected = [block.ranges for block in once.blocks()]
    folder = tmp_path / "copies"
    folder.mkdir()
    copy = folder / paths[0].name
    (shutil.copytree if paths[0].is_dir() else shutil.copy)(paths[0], copy)
    again = paths[0].parent / ".." / paths[0].parent.name / paths[0].name
    for more, said in ((again, "is given twice: it is read once"), (copy, "is a copy of")):
        twice = open_recording([*paths, more], InputConfig())
        np.testing.assert_array_equal([block.ranges for block in twice.blocks()], expected)
        report, single = twice.report(), once.report()
        assert (report.sha256, report.files) == (single.sha256, single.files)
        assert report.scans == single.scans
        assert [w for w in report.warnings if said in w] == list(twice.source.twice)
        assert len(twice.source.twice) == 1


def test_scans_that_two_files_have_are_marked_and_said(tmp_path):
    paths = [write(tmp_path / f"{size}.mcap", MESSAGES, size) for size in (3000, 4000)]
    recording = open_recording(paths, InputConfig())
    blocks = list(recording.blocks(size=5))
    repeated = np.concatenate([block.repeated for block in blocks])
    np.testing.assert_array_equal(repeated, np.arange(2 * cases.SCANS) % 2 == 1)
    report = recording.report()
    assert report.dropped == {"repeated_scan": cases.SCANS, "repeated_stamp": cases.SCANS}
    assert any(f"{cases.SCANS} scans are in the log twice" in w for w in report.warnings)


def test_scans_of_one_stamp_that_differ_are_no_repeats(tmp_path):
    others = [m for m in scans() if m[2] == cases.stamps()[3] + 1]
    message = cases.scan_message(cases.STORE2, cases.stamps()[3], 4)
    others = [recorded(message, others[0][1], "/scan", others[0][2])]
    paths = [write(tmp_path / "a.mcap", MESSAGES), write(tmp_path / "b.mcap", others)]
    recording = open_recording(paths, InputConfig())
    assert all(block.repeated is None for block in recording.blocks())
    assert recording.report().dropped == {"repeated_stamp": 1}


# ------------------------------------------------------------- parts that follow each other

NEXT = cases.stamps()[-1] - cases.START + cases.SECOND  # from one drive's beginning to the next's


def second_drive(at=(0.0, 0.0, 0.0), after_ns=NEXT, **geometry):
    """A drive that begins `at` that much beyond where the first one ends, standing still."""
    end = np.add(cases.pose(cases.odometry_stamps()[-1]), at)
    out = [mounted(geometry.pop("mount", cases.MOUNT_X))]
    for stamp_ns in cases.odometry_stamps():
        message = cases.odometry_message(cases.STORE2, stamp_ns + after_ns, tuple(end))
        out.append(recorded(message, "nav_msgs/msg/Odometry", "/odom", stamp_ns))
    return late([*out, *scans(offset_ns=after_ns, **geometry)], after_ns)


def parts_warnings(first, second):
    recording = open_recording([second, first], InputConfig())
    for _ in recording.blocks():
        pass
    return [w for w in recording.report().warnings if "a.mcap and b.mcap" in w]


DAY_NS = 86_400 * cases.SECOND
FOLLOWING = {
    "goes on": ({}, []),
    "goes on much later": ({"after_ns": 3600 * cases.SECOND}, []),
    "a step": ({"at": (1.0, 0.0, 0.0)}, []),
    "elsewhere": ({"at": (3.0, 4.0, 0.1)}, ["odometry jumps by 5.00 m and 6 degrees"]),
    "turned": ({"at": (0.0, 0.0, 3.0)}, ["odometry jumps by 0.00 m and 172 degrees"]),
    "elsewhere, later": (
        {"at": (3.0, 4.0, 0.0), "after_ns": 3600 * cases.SECOND},
        ["odometry jumps by 5.00 m"],
    ),
    "days later": ({"after_ns": 3 * DAY_NS}, ["3.0 days lie between"]),
    "elsewhere, days later": (
        {"at": (3.0, 4.0, 0.0), "after_ns": 3 * DAY_NS},
        ["odometry jumps by 5.00 m", "3.0 days lie between"],
    ),
}


@pytest.mark.parametrize("kind", FOLLOWING)
def test_a_seam_that_looks_like_two_recordings_is_said(tmp_path, kind):
    options, expected = FOLLOWING[kind]
    paths = [
        write(tmp_path / "a.mcap", MESSAGES),
        write(tmp_path / "b.mcap", second_drive(**options)),
    ]
    found = parts_warnings(*paths)
    assert len(found) == len(expected)
    assert all(text in warning for text, warning in zip(expected, found, strict=True))


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        ({"frame": "rear"}, "of the frames laser and rear"),
        ({"step": 0.5}, "180 beams from -90 degrees and 180 beams"),
        ({"mount": 0.6}, "mounted at 0.25,0.00,0.00 and 0.60,0.00,0.00"),
    ],
)
def test_files_of_two_lasers_that_follow_each_other_are_no_recording(tmp_path, options, fault):
    paths = [
        write(tmp_path / "a.mcap", MESSAGES),
        write(tmp_path / "b.mcap", second_drive(**options)),
    ]
    with pytest.raises(
        InputError, match=r"a\.mcap and .*b\.mcap are no parts of one recording"
    ) as e:
        open_recording(paths, InputConfig())
    assert fault in str(e.value)
    assert "overlap" not in str(e.value)


def test_a_seam_of_text_logs_is_watched_too(tmp_path):
    text = cases.carmen_text()
    lines = text.splitlines(keepends=True)
    half = len(lines) // 2
    first, second, other = (tmp_path / name for name in ("a.log", "b.log", "other.log"))
    first.write_text("".join(lines[:half]))
    second.write_text("".join(lines[half:]))
    other.write_text(shifted("".join(lines[half:]), 7.0) + "\n")
    for part, expected in ((second, []), (other, ["odometry jumps by 7."])):
        recording = open_recording([first, part], InputConfig())
        assert sum(len(block) for block in recording.blocks()) == cases.SCANS
        found = [w for w in recording.report().warnings if f"a.log and {part.name}" in w]
        assert [w[: len(e)] for w, e in zip(found, expected, strict=True)] == expected


def shifted(text, by):
    """A CARMEN log of a robot that drives elsewhere."""
    lines = [line.split(" ") for line in text.splitlines()]
    for words in lines:
        if words[0] == "ODOM":
            words[1] = f"{float(words[1]) + by:.6f}"
        elif words[0] == "FLASER":
            words[182] = words[185] = f"{float(words[185]) + by:.6f}"
    return "\n".join([" ".join(words) for words in lines])


def test_carmen_logs_that_overlap_and_contradict_each_other_are_no_recording(tmp_path):
    text = cases.carmen_text()
    lines = text.splitlines(keepends=True)
    middle = len(lines) // 2
    logs = {
        "whole": text,
        "elsewhere": shifted(text, 1.0),
        "first": "".join(lines[: middle + 5]),
        "second": "".join(lines[middle - 5 :]),
    }
    paths = {name: tmp_path / f"{name}.log" for name in logs}
    for name, path in paths.items():
        path.write_text(logs[name])
    with pytest.raises(InputError, match="odometry is at"):
        open_recording([paths["whole"], paths["elsewhere"]], InputConfig())
    for parts in (("first", "second"), ("whole", "second")):
        recording = open_recording([paths[name] for name in parts], InputConfig())
        assert sum(len(block) for block in recording.blocks()) >= cases.SCANS


def test_single_readings_that_lie_part_no_recording(tmp_path):
    wrong = list(odometry((50.0, 0.0, 0.0)))[20:22]
    others = [m for m in MESSAGES if m[2] not in {log_ns + 3_000_000 for _, _, log_ns, _ in wrong}]
    paths = [write(tmp_path / "a.mcap", MESSAGES), write(tmp_path / "b.mcap", [*others, *wrong])]
    assert len(list(open_recording(paths, InputConfig()).blocks())) == 1
