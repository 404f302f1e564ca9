"""Damaged logs: what is intact is read, what is lost is said, and nothing else comes out."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from pathlib import Path

import log_cases as cases
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType

from hiermap_cli.config import InputConfig
from hiermap_cli.errors import InputError
from hiermap_cli.logs.audit import audit
from hiermap_cli.logs.recording import open_recording

CUT = [
    "mcap zstd", "mcap lz4", "mcap plain", "mcap unchunked", "mcap ros1", "mcap json",
    "bag", "bag bz2", "bag lz4", "rosbag2", "rosbag2 mcap",
    "carmen", "carmen gzip", "wean", "wean gzip",
]  # fmt: skip


def read(paths):
    recording = open_recording(paths, InputConfig())
    blocks = list(recording.blocks())
    return blocks, recording.report()


def data_file(paths):
    """The file that holds the messages."""
    (path,) = paths
    if path.is_dir():
        (path,) = [p for p in path.iterdir() if p.name != "metadata.yaml"]
    return path


def read_stamps(paths):
    blocks, report = read(paths)
    return [t for block in blocks for t in block.stamps_ns.tolist()], report


@pytest.mark.parametrize("kind", CUT)
@pytest.mark.parametrize("share", [0.9, 0.6])
def test_a_cut_log_is_read_as_far_as_it_goes(tmp_path, kind, share):
    paths = cases.FORMATS[kind](tmp_path)
    path = data_file(paths)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    stamps, report = read_stamps(paths)
    assert stamps == cases.stamps()[: len(stamps)]
    # Compressed small logs hold little in their first half; the bulk of the rest must be there.
    assert len(stamps) >= (share - 0.35) * cases.SCANS
    said = bool(report.lost) or any("malformed" in reason for reason in report.dropped)
    assert said or len(stamps) == cases.SCANS


def test_a_compressed_file_that_is_cut_says_so(tmp_path):
    (folder,) = cases.FORMATS["rosbag2 file zstd"](tmp_path)
    path = data_file([folder])
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match="cut off"):
        read([folder])


def test_an_unclosed_mcap_is_read_whole(tmp_path):
    path = tmp_path / "log.mcap"
    cases.write_ros2_mcap(path, CompressionType.NONE, finish=False)
    stamps, report = read_stamps([path])
    # What the writer still held in memory never reached the file.
    assert len(stamps) >= cases.SCANS - 6
    assert stamps == cases.stamps()[: len(stamps)]
    assert any("not closed" in loss for loss in report.lost)


@pytest.mark.parametrize("compression", list(CompressionType))
def test_one_damaged_chunk_costs_that_chunk(tmp_path, compression):
    path = tmp_path / "log.mcap"
    cases.write_ros2_mcap(path, compression)
    data = bytearray(path.read_bytes())
    at = chunks_of(data)[3] + 120
    data[at : at + 8] = bytes(b ^ 0x5A for b in data[at : at + 8])
    path.write_bytes(data)
    stamps, report = read_stamps([path])
    assert cases.SCANS - 7 <= len(stamps) < cases.SCANS
    assert set(stamps) < set(cases.stamps())
    loss, *counts = report.lost
    assert "chunk at byte" in loss
    assert "messages lost" in loss
    missing = cases.SCANS - len(stamps)
    assert f"/scan: {missing} of {cases.SCANS} messages that the index counts are missing" in counts


def test_a_damaged_length_does_not_hide_the_chunks_behind_it(tmp_path):
    path = tmp_path / "log.mcap"
    cases.write_ros2_mcap(path)
    data = bytearray(path.read_bytes())
    chunks = chunks_of(data)
    assert len(chunks) > 4
    data[chunks[2] + 1 + 2] ^= 0x10  # the record is now a megabyte long
    path.write_bytes(data)
    stamps, report = read_stamps([path])
    assert cases.SCANS - 7 <= len(stamps) < cases.SCANS
    assert stamps[-1] == cases.stamps()[-1]
    assert report.lost


def chunks_of(data):
    """Where the chunk records of an MCAP begin, in order."""
    at, found = 8, []
    while at < len(data) - 8:
        if data[at] == 6:
            found.append(at)
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    return found


def test_a_damaged_summary_is_not_believed(tmp_path):
    path = tmp_path / "log.mcap"
    cases.write_ros2_mcap(path)
    data = path.read_bytes()
    at = data.rindex(b"/scan")
    path.write_bytes(data[:at] + b"/span" + data[at + 5 :])
    stamps, report = read_stamps([path])
    assert stamps == cases.stamps()
    assert report.scan_topic == "/scan"
    assert any("summary" in loss for loss in report.lost)


def test_messages_outside_of_chunks_have_the_checksum_of_the_data(tmp_path):
    path = tmp_path / "log.mcap"
    cases.write_ros2_mcap(path, chunked=False, data_crcs=True)
    assert read([path])[1].lost == ()
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    assert any("checksum" in loss for loss in read([path])[1].lost)


def test_a_bag_without_index_is_read_whole(tmp_path):
    path = tmp_path / "log.bag"
    cases.write_bag1(path)
    data = path.read_bytes()
    # The index section begins with the connections behind the last chunk's index.
    at = data.rindex(b"op=\x04")
    end = data.index(b"op=\x07", at)
    path.write_bytes(data[: end - 60])
    stamps, report = read_stamps([path])
    assert stamps == cases.stamps()
    assert report.lost


def test_rows_of_a_damaged_database_behind_the_damage_are_read(tmp_path):
    folder = tmp_path / "bag"
    cases.write_rosbag2(folder)
    path = data_file([folder])
    whole = read_stamps([folder])[0]
    size = page_size(path)
    data = bytearray(path.read_bytes())
    pages = len(data) // size
    # A page of the middle: overflow or leaf of the table of messages.
    at = size * (pages // 2)
    data[at : at + size] = b"\xff" * size
    path.write_bytes(data)
    stamps, report = read_stamps([folder])
    assert 0.5 * len(whole) < len(stamps) <= len(whole)
    assert report.lost or report.dropped


def page_size(path):
    database = sqlite3.connect(path)
    (size,) = database.execute("PRAGMA page_size").fetchone()
    database.close()
    return size


@pytest.mark.parametrize("content", [b"", b"\0" * 3000, b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n", b"x"])
@pytest.mark.parametrize("name", ["a.mcap", "a.bag", "a.db3", "a.log", "a.log.gz", "a"])
def test_what_is_no_log_is_refused_in_one_line(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        open_recording([path], InputConfig())
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_without_a_bag_is_refused(tmp_path):
    with pytest.raises(InputError, match="no recording in this folder"):
        open_recording([tmp_path], InputConfig())


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        open_recording([tmp_path / "none.mcap"], InputConfig())


def test_an_old_bag_is_refused_with_the_reason(tmp_path):
    path = tmp_path / "old.bag"
    path.write_bytes(b"#ROSBAG V1.2\n" + b"\0" * 100)
    with pytest.raises(InputError, match=r"1\.2"):
        open_recording([path], InputConfig())


@pytest.mark.parametrize("text", ["", "rosbag2_bagfile_information: [", "a: 1", "[1, 2]", "\xff"])
def test_without_its_metadata_a_folder_is_read_all_the_same(tmp_path, text):
    folder = tmp_path / "bag"
    cases.write_rosbag2(folder)
    (folder / "metadata.yaml").write_text(text, encoding="latin-1")
    stamps, report = read_stamps([folder])
    assert stamps == cases.stamps()
    assert any("metadata.yaml" in loss for loss in report.lost)


def test_a_missing_part_is_said(tmp_path):
    folder = tmp_path / "bag"
    cases.write_rosbag2(folder)
    cases.list_more(folder, "bag_1.db3")
    stamps, report = read_stamps([folder])
    assert stamps == cases.stamps()
    assert any("bag_1.db3" in loss for loss in report.lost)


_ORIGINALS: dict[str, Path] = {}


def original(kind):
    """The log of a kind, written once for all examples."""
    if kind not in _ORIGINALS:
        folder = Path(tempfile.mkdtemp(prefix="hiermap-tests-"))
        cases.FORMATS[kind](folder)
        _ORIGINALS[kind] = folder
    return _ORIGINALS[kind]


@pytest.fixture(scope="module", autouse=True)
def _removed_at_the_end():
    yield
    for folder in _ORIGINALS.values():
        shutil.rmtree(folder)
    _ORIGINALS.clear()


flips = st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), max_size=6)


@pytest.mark.parametrize(
    "kind", [*CUT, "mcap protobuf", "mcap without schemas", "carmen split", "rosbag2 file zstd"]
)
@settings(
    max_examples=40,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(flips=flips, cut=st.floats(0, 1), hole=st.floats(0, 1), hole_size=st.integers(0, 300))
def test_flipped_and_cut_bytes_give_a_part_or_an_input_error(
    tmp_path_factory, kind, flips, cut, hole, hole_size
):
    folder = tmp_path_factory.mktemp("damaged")
    source = original(kind)
    shutil.copytree(source, folder, dirs_exist_ok=True)
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    paths = sorted(folder.iterdir())
    for path in files:
        data = bytearray(path.read_bytes())
        for place, mask in flips:
            data[int(place * len(data))] ^= mask
        at = int(hole * len(data))
        del data[at : at + hole_size]
        if cut > 0.5:
            del data[int(cut * len(data)) :]
        path.write_bytes(data)
    try:
        blocks, report = read(paths)
    except InputError as error:
        assert "\n" not in str(error)
        return
    finally:
        shutil.rmtree(folder)
    assert report.scans == sum(len(block) for block in blocks)
    stamps = np.concatenate([block.stamps_ns for block in blocks])
    assert (np.diff(stamps) >= 0).all()
    for block in blocks:
        assert np.isfinite(block.odometry).all()
        assert not np.isneginf(block.ranges).any()
        finite = block.ranges[np.isfinite(block.ranges)]
        assert (finite > 0).all()
        assert np.isfinite(block.laser).all()


@pytest.mark.parametrize("kind", ["mcap zstd", "bag", "carmen gzip", "rosbag2"])
def test_inspect_reads_what_run_refuses(tmp_path, kind):
    paths = cases.FORMATS[kind](tmp_path)
    path = data_file(paths)
    data = path.read_bytes()
    path.write_bytes(data[: int(0.7 * len(data))])
    report = audit(paths, InputConfig(scan_topic="/no/such/topic"))
    assert report.use is None
    assert "/no/such/topic" in report.fault
    assert report.lost
    assert any(topic.messages > 5 for topic in report.topics)
