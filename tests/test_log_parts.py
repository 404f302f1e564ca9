"""Recordings in several files: one after the other, in any order, or side by side."""

from __future__ import annotations

import shutil
import sqlite3

import log_cases as cases
import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

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
