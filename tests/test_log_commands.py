"""`hiermap inspect` and `hiermap convert`, as a user calls them."""

from __future__ import annotations

import json

import click
import log_cases as cases
import numpy as np
import pytest
import room_case as room
from click.testing import CliRunner
from mcap.reader import make_reader
from real_data import DATA

from hiermap_cli.commands.main import cli
from hiermap_cli.config import InputConfig
from hiermap_cli.logs.recording import open_recording
from hiermap_cli.logs.records import Mount


def hiermap(*words):
    return CliRunner().invoke(cli, [str(word) for word in words])


def blocks(paths, **options):
    return list(open_recording(paths, InputConfig(**options)).blocks())


def joined(found, name):
    return np.concatenate([getattr(block, name) for block in found])


def same(first, second):
    for name in ("stamps_ns", "ranges", "has_odometry", "odometry"):
        np.testing.assert_array_equal(joined(first, name), joined(second, name))
    assert [block.laser for block in first] == [block.laser for block in second]
    assert first[0].mount.flipped == second[0].mount.flipped
    np.testing.assert_allclose(first[0].mount.pose(), second[0].mount.pose(), atol=1e-12)


@pytest.mark.parametrize("name", sorted(cli.list_commands(click.Context(cli))))
def test_examples_in_the_help_are_lines_of_their_own(name):
    text = hiermap(name, "--help").stdout
    assert "\\b" not in text
    assert "\b" not in text
    for line in text.splitlines():
        assert line.count("hiermap " + name) <= 1


# ----------------------------------------------------------------------- inspect


def test_inspect_shows_topics_and_what_run_would_use(tmp_path):
    (path,) = cases.FORMATS["mcap zstd"](tmp_path)
    result = hiermap("inspect", path)
    assert result.exit_code == 0
    for word in ("/scan", "/odom", "/tf_static", "sensor_msgs/msg/LaserScan", "header stamps"):
        assert word in result.stdout
    assert "x 0.250 m" in result.stdout
    assert result.stderr == ""


@pytest.mark.parametrize("kind", ["mcap json", "bag", "rosbag2", "carmen gzip", "wean"])
def test_inspect_as_json(tmp_path, kind):
    paths = cases.FORMATS[kind](tmp_path)
    result = hiermap("inspect", *paths, "--json")
    assert result.exit_code == 0
    report = json.loads(result.stdout)
    assert report["format"] == "hiermap-inspect"
    assert report["use"]["scans"] == cases.SCANS
    assert report["use"]["laser"]["mount"]["x"] == pytest.approx(cases.MOUNT_X)
    assert report["fault"] is None
    counted = {topic["name"]: topic["messages"] for topic in report["topics"]}
    assert counted[report["use"]["scan_topic"]] == cases.SCANS
    (scans,) = [t for t in report["topics"] if t["name"] == report["use"]["scan_topic"]]
    assert scans["rate"] == pytest.approx(5.0)
    assert scans["longest_gap"] == pytest.approx(0.2)


def test_inspect_shows_a_log_that_run_refuses(tmp_path):
    path = tmp_path / "log.mcap"
    cases.write_foxglove_mcap(path, "json", poses=True)
    result = hiermap("inspect", path, "--odom-topic", "/none")
    assert result.exit_code == 1
    assert "/pose" in result.stdout
    assert result.stderr.count("\n") == 1
    assert "no topic /none" in result.stderr


def test_inspect_warns_on_stderr_only(tmp_path):
    path = room.write(tmp_path / "x.mcap", real=Mount(yaw=3.14159))
    result = hiermap("inspect", path, "--json")
    json.loads(result.stdout)
    assert "warning: " in result.stderr
    assert "rear" in result.stderr


def test_inspect_takes_the_input_of_a_configuration(tmp_path):
    (path,) = cases.FORMATS["carmen"](tmp_path)
    config = tmp_path / "c.yaml"
    config.write_text("input:\n  mount: {x: 0.7}\n  start: 1.0\n")
    report = json.loads(hiermap("inspect", path, "--config", config, "--json").stdout)
    assert report["use"]["laser"]["mount"]["x"] == 0.7
    over = hiermap("inspect", path, "--config", config, "--mount", "0.1,0,1.5", "--json")
    assert json.loads(over.stdout)["use"]["laser"]["mount"]["yaw"] == 1.5
    assert report["use"]["scans"] == cases.SCANS - 4


@pytest.mark.parametrize("command", [["inspect"], ["convert", "-o", "x.mcap"]])
def test_what_is_no_log_gives_one_line_and_status_1(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "x.bin"
    path.write_bytes(b"\x01\x02" * 500)
    result = hiermap(*command, path)
    assert result.exit_code == 1
    assert result.stderr.count("\n") == 1
    assert "not a log that hiermap reads" in result.stderr
    assert not (tmp_path / "x.mcap").exists()


# ----------------------------------------------------------------------- convert


@pytest.mark.parametrize("kind", sorted(cases.FORMATS))
def test_a_conversion_reads_as_its_source(tmp_path, kind):
    paths = cases.FORMATS[kind](tmp_path)
    target = tmp_path / "converted" / "x.mcap"
    target.parent.mkdir()
    result = hiermap("convert", *paths, "-o", target)
    assert result.exit_code == 0, result.stderr
    assert result.stdout == ""
    same(blocks(paths), blocks([target]))
    again = target.with_name("again.mcap")
    assert hiermap("convert", *paths, "-o", again).exit_code == 0
    assert again.read_bytes() == target.read_bytes()


def test_a_conversion_has_the_topics_of_ros(tmp_path):
    (path,) = cases.FORMATS["carmen"](tmp_path)
    target = tmp_path / "x.mcap"
    assert hiermap("convert", path, "-o", target, "-q").exit_code == 0
    with target.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    types = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
    assert types == {
        "/scan": "sensor_msgs/msg/LaserScan",
        "/odom": "nav_msgs/msg/Odometry",
        "/tf_static": "tf2_msgs/msg/TFMessage",
    }
    with target.open("rb") as file:
        schema, _, message = next(make_reader(file).iter_messages(topics=["/scan"]))
    scan = cases.STORE2.deserialize_cdr(message.data, schema.name)
    assert scan.header.stamp.sec * cases.SECOND + scan.header.stamp.nanosec == cases.stamps()[0]
    np.testing.assert_array_equal(scan.ranges, cases.ranges(0).astype(np.float32))


def test_a_conversion_of_broken_stamps_reads_as_its_source(tmp_path):
    path = tmp_path / "log.carmen"
    lines = cases.carmen_text().splitlines()
    # The clock is set back in the middle, one stamp is nonsense, some stand still.
    lines[20] = lines[20].replace(" 16000000", " 95000000")
    lines[30] = lines[31] = lines[32]
    for i in range(40, len(lines)):
        lines[i] = lines[i].replace(" 16000000", " 15000000")
    path.write_text("\n".join(lines))
    target = tmp_path / "x.mcap"
    assert hiermap("convert", path, "-o", target).exit_code == 0
    found = blocks([path])
    assert len(joined(found, "stamps_ns")) == sum(line.startswith("FLASER") for line in lines)
    same(found, blocks([target]))


def test_a_conversion_without_any_stamps_reads_as_its_source(tmp_path):
    path = tmp_path / "log.carmen"
    lines = []
    for line in cases.carmen_text().splitlines():
        words = line.split()
        if words[0] in ("FLASER", "ODOM"):
            words[-3] = words[-1] = "0.0"
        lines.append(" ".join(words))
    path.write_text("\n".join(lines))
    target = tmp_path / "x.mcap"
    result = hiermap("convert", path, "-o", target)
    assert result.exit_code == 0
    assert "order of records" in result.stderr
    found = blocks([path])
    assert len(joined(found, "stamps_ns")) == cases.SCANS
    same(found, blocks([target]))


def test_a_part_is_converted(tmp_path):
    (path,) = cases.FORMATS["mcap zstd"](tmp_path)
    target = tmp_path / "x.mcap"
    result = hiermap(
        "convert", path, "-o", target, "--start", 1, "--end", 2, "--mount", "1,2,3,flipped"
    )
    assert result.exit_code == 0
    (block,) = blocks([target])
    assert block.stamps_ns.tolist() == [
        t for t in cases.stamps() if 1 <= (t - cases.START) / 1e9 <= 2
    ]
    assert block.mount == Mount(1.0, 2.0, 3.0, flipped=True)
    assert block.has_odometry.all()


def test_convert_replaces_nothing_without_force(tmp_path):
    (path,) = cases.FORMATS["carmen"](tmp_path)
    target = tmp_path / "x.mcap"
    assert hiermap("convert", path, "-o", target).exit_code == 0
    before = target.read_bytes()
    result = hiermap("convert", path, "-o", target, "--end", "1")
    assert result.exit_code == 2
    assert "--force" in result.stderr
    assert target.read_bytes() == before
    assert hiermap("convert", path, "-o", target, "--end", "1", "--force").exit_code == 0
    assert sum(map(len, blocks([target]))) < sum(map(len, blocks([path])))


def test_convert_replaces_nothing_that_it_has_not_written(tmp_path):
    (path,) = cases.FORMATS["carmen"](tmp_path)
    (tmp_path / "other").mkdir()
    (foreign,) = cases.FORMATS["mcap zstd"](tmp_path / "other")
    text = tmp_path / "x.mcap"
    text.write_text("precious")
    for target in (foreign, text):
        before = target.read_bytes()
        for options in ((), ("--force",)):
            result = hiermap("convert", path, "-o", target, *options)
            assert result.exit_code == 2
            assert "never replaces it" in result.stderr
            assert "--force" not in result.stderr
            assert target.read_bytes() == before
    text.write_text("")
    assert hiermap("convert", path, "-o", text, "--force").exit_code == 0
    assert blocks([text])


def test_convert_does_not_write_over_its_own_log(tmp_path):
    (path,) = cases.FORMATS["mcap zstd"](tmp_path)
    before = path.read_bytes()
    result = hiermap("convert", path, "-o", path, "--force")
    assert result.exit_code == 2
    assert "the log itself" in result.stderr
    assert path.read_bytes() == before


@pytest.mark.parametrize("target", ["none/x.mcap", "."])
def test_convert_refuses_a_target_that_cannot_be(tmp_path, target):
    (path,) = cases.FORMATS["carmen"](tmp_path)
    result = hiermap("convert", path, "-o", tmp_path / target)
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize("name", ["part.txt", "part", "part.mcap.gz", ".mcap"])
def test_convert_writes_an_mcap_under_no_other_ending(tmp_path, name):
    (path,) = cases.FORMATS["carmen"](tmp_path)
    result = hiermap("convert", path, "-o", tmp_path / name, "--force")
    assert result.exit_code == 2
    assert "name that ends in .mcap" in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert not (tmp_path / name).exists()
    assert hiermap("convert", path, "-o", tmp_path / "PART.MCAP").exit_code == 0


def test_convert_of_nothing_leaves_nothing(tmp_path):
    (path,) = cases.FORMATS["mcap zstd"](tmp_path)
    result = hiermap("convert", path, "-o", tmp_path / "x.mcap", "--start", 500)
    assert result.exit_code == 1
    assert "between --start and --end" in result.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["log.mcap"]


def test_convert_says_what_was_lost_and_as_json(tmp_path):
    (path,) = cases.FORMATS["mcap zstd"](tmp_path)
    path.write_bytes(path.read_bytes()[:-3000])
    result = hiermap("convert", path, "-o", tmp_path / "x.mcap", "--json")
    assert result.exit_code == 0
    summary = json.loads(result.stdout)
    assert summary["lost"]
    assert "lost: " in result.stderr
    assert summary["scans"] == len(joined(blocks([tmp_path / "x.mcap"]), "stamps_ns"))


@pytest.mark.skipif(not DATA.exists(), reason="the real logs are not here")
@pytest.mark.parametrize("log", ["csail/log.carmen.gz", "aces/log.carmen.gz", "neato_rosbag2"])
def test_conversions_of_real_logs_read_as_their_sources(tmp_path, log):
    target = tmp_path / "x.mcap"
    assert hiermap("convert", DATA / log, "-o", target).exit_code == 0
    same(blocks([DATA / log]), blocks([target]))


@pytest.mark.skipif(not DATA.exists(), reason="the real logs are not here")
@pytest.mark.parametrize(
    ("log", "scans", "odometry", "beams", "start", "share_inf"),
    [
        ("fr079/log.carmen.gz", 4791, 4934 + 4791, 360, 227_623_000, 36004),
        ("csail/log.carmen.gz", 1988, 1988, 361, 1134864629_895182000, 23711),
        ("aces/log.carmen.gz", 440, 7374 + 440, 180, None, 620),
        ("wean/robotdata1.log.gz", 713, 1505 + 713, 180, 25_466_000, None),
        ("neato_rosbag2", 357, 920, 720, 1663967375_543606542, None),
    ],
)
def test_real_logs_are_read_whole(log, scans, odometry, beams, start, share_inf):
    recording = open_recording([DATA / log], InputConfig())
    found = list(recording.blocks())
    report = recording.report()
    assert (report.scans, report.odometry, found[0].laser.beams) == (scans, odometry, beams)
    assert report.lost == ()
    assert set(report.dropped) <= {"before_first_odometry", "after_last_odometry"}
    if start is not None:
        assert int(found[0].stamps_ns[0]) == start
    if share_inf is not None:
        assert sum(int(np.isinf(block.ranges).sum()) for block in found) == share_inf
    if log == "neato_rosbag2":
        np.testing.assert_allclose(recording.mount.pose(), [0.003936, 0, np.pi / 2], atol=1e-6)
        assert report.dropped["before_first_odometry"] == 2
    if log.startswith("wean"):
        assert recording.mount == Mount(0.25)
