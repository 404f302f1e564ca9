"""Which topics, which mount, which clock: chosen, or refused with what to do."""

from __future__ import annotations

import math

import log_cases as cases
import numpy as np
import pytest
from mcap.writer import Writer as McapWriter

from hiermap_cli.config import InputConfig, MountConfig
from hiermap_cli.errors import InputError
from hiermap_cli.logs.recording import open_recording
from hiermap_cli.logs.records import Mount

SECOND = cases.SECOND
LEVEL = (0.0, 0.0, 0.0, 1.0)
SCAN, ODOM, TF = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"


class Log:
    """An MCAP with any messages on any topics."""

    def __init__(self, path):
        self.path = path
        self.messages = []

    def add(self, topic, kind, stamp_ns, message, log_ns=None):
        data = bytes(cases.STORE2.serialize_cdr(message, kind))
        self.messages.append((stamp_ns if log_ns is None else log_ns, topic, kind, data))

    def scans(self, topic="/scan", count=10, frame="laser", stamps=None, log=None):
        for i in range(count):
            stamp_ns = (i + 1) * SECOND if stamps is None else stamps[i]
            message = cases.scan_message(cases.STORE2, stamp_ns, i)
            message.header.frame_id = frame
            self.add(topic, SCAN, stamp_ns, message, None if log is None else log[i])

    def odometry(self, topic="/odom", count=11, child="base_link", stamps=None, log=None):
        for i in range(count):
            stamp_ns = i * SECOND + 5 if stamps is None else stamps[i]
            message = cases.odometry_message(cases.STORE2, stamp_ns, (0.1 * i, 0, 0), child=child)
            self.add(topic, ODOM, stamp_ns, message, None if log is None else log[i])

    def transforms(self, edges, topic="/tf_static", stamp_ns=0):
        self.add(topic, TF, stamp_ns, cases.tf_message(cases.STORE2, stamp_ns, tuple(edges)))

    def moving(self, parent, child, count=11, topic="/tf"):
        for i in range(count):
            edge = (parent, child, (0.1 * i, 0.0, 0.0), LEVEL)
            self.transforms([edge], topic, i * SECOND + 5)

    def unknown(self, topic="/imu"):
        self.messages.append((5, topic, "sensor_msgs/msg/Imu", b"\0\1\0\0"))

    def open(self, **options):
        with self.path.open("wb") as file:
            writer = McapWriter(file)
            writer.start("ros2", "tests")
            channels = {}
            for log_ns, topic, kind, data in self.messages:
                if topic not in channels:
                    schema = writer.register_schema(kind, "ros2msg", b"")
                    channels[topic] = writer.register_channel(topic, "cdr", schema)
                writer.add_message(channels[topic], log_ns, data, log_ns)
            writer.finish()
        return open_recording([self.path], InputConfig(**options))


@pytest.fixture
def log(tmp_path):
    return Log(tmp_path / "log.mcap")


def refused(log, match, **options):
    with pytest.raises(InputError, match=match) as caught:
        log.open(**options)
    return str(caught.value)


# ------------------------------------------------------------------------ topics


def test_two_scan_topics_are_listed_with_the_option(log):
    log.scans("/front")
    log.scans("/rear")
    log.odometry()
    text = refused(log, "2 topics hold laser scans")
    assert "/front" in text
    assert "/rear" in text
    assert "--scan-topic" in text
    assert log.open(scan_topic="/rear").scan_topic == "/rear"


@pytest.mark.parametrize("other", ["/scan_rear", "/a", "/zz/scan_filtered"])
def test_the_usual_name_goes_first(log, other):
    log.scans(other)
    log.scans("/scan")
    log.odometry("/wheels")
    log.odometry("/odom")
    recording = log.open()
    assert (recording.scan_topic, recording.odometry_topic) == ("/scan", "/odom")


def test_a_usual_name_in_a_namespace_goes_first_if_it_is_the_only_one(log):
    log.scans("/robot/scan")
    log.scans("/robot/rear")
    log.odometry("/robot/odom")
    log.odometry("/robot/visual")
    recording = log.open()
    assert (recording.scan_topic, recording.odometry_topic) == ("/robot/scan", "/robot/odom")
    log.scans("/other/scan")
    refused(log, "3 topics hold laser scans")


def test_two_odometries_are_listed_with_the_option(log):
    log.scans()
    log.odometry("/wheels")
    log.odometry("/visual")
    assert "--odom-topic" in refused(log, "2 topics hold odometry")
    assert log.open(odometry_topic="/visual").odometry_topic == "/visual"


def test_no_scans_says_what_there_is(log):
    log.odometry()
    log.unknown()
    assert "/imu (sensor_msgs/msg/Imu)" in refused(log, "no laser scans in it")


def test_no_odometry_says_what_there_is(log):
    log.scans()
    log.unknown()
    assert "/imu (sensor_msgs/msg/Imu)" in refused(log, "no odometry in it")


def test_a_topic_that_is_not_there_or_of_another_type(log):
    log.scans()
    log.odometry()
    assert "/scan" in refused(log, "no topic /none", scan_topic="/none")
    assert "no laser scans" in refused(log, "--scan-topic /odom holds", scan_topic="/odom")
    refused(log, "no topic /none", odometry_topic="/none")


def test_static_transforms_are_no_odometry(log):
    log.scans()
    log.odometry()
    log.transforms([("base_link", "laser", (0.2, 0.0, 0.0), LEVEL)])
    text = refused(log, "no odometry; fitting: /odom", odometry_topic="/scan")
    assert "/tf_static" not in text
    for wanted in ("/tf_static", "/tf_static:base_link->laser"):
        text = refused(log, "/tf_static holds static transforms", odometry_topic=wanted)
        assert "no odometry; fitting: /odom (nav_msgs/msg/Odometry)" in text


@pytest.mark.parametrize("readings", [1, 2])
def test_a_single_reading_is_no_odometry(log, readings):
    log.scans()
    log.odometry(count=readings)
    if readings == 1:
        refused(log, "a single reading of odometry on /odom")
    else:
        assert sum(len(block) for block in log.open().blocks()) > 0


def test_a_log_of_unknown_types_is_refused(log):
    log.unknown("/a")
    log.unknown("/b")
    refused(log, "no laser scans in it, only /a")


def test_scans_of_nan_are_refused(log):
    log.odometry()
    for i in range(20):
        message = cases.scan_message(cases.STORE2, (i + 1) * SECOND, i)
        message.ranges = np.full(180, [math.nan, 0.0, -1.0][i % 3], dtype=np.float32)
        log.add("/scan", SCAN, (i + 1) * SECOND, message)
    recording = log.open()
    with pytest.raises(InputError, match="none of the 20 scans on /scan has a valid range"):
        list(recording.blocks())


@pytest.mark.parametrize(
    ("start", "step", "beams", "match"),
    [
        (-90.0, 1.0, 180, "are these degrees"),
        (math.nan, 0.01, 180, "make no sense"),
        (-1.0, 0.0, 180, "make no sense"),
        (-1.0, 0.01, 0, "are empty"),
    ],
)
def test_scans_without_directions_are_refused(log, start, step, beams, match):
    log.odometry()
    for i in range(5):
        message = cases.scan_message(cases.STORE2, (i + 1) * SECOND, i)
        message.angle_min, message.angle_increment = start, step
        message.ranges = np.ones(beams, dtype=np.float32)
        log.add("/scan", SCAN, (i + 1) * SECOND, message)
    refused(log, match)


def test_beams_that_run_clockwise_are_said(log):
    log.odometry()
    for i in range(5):
        message = cases.scan_message(cases.STORE2, (i + 1) * SECOND, i)
        message.angle_min, message.angle_increment = 1.5, -0.01
        log.add("/scan", SCAN, (i + 1) * SECOND, message)
    recording = log.open()
    assert any("clockwise" in warning for warning in recording.plan.warnings)
    assert next(recording.blocks()).laser.angle_increment < 0


# -------------------------------------------------------------------- transforms


def test_odometry_from_the_only_fitting_transform(log):
    log.scans()
    log.moving("odom", "base_link")
    log.moving("map", "odom")
    log.transforms([("base_link", "laser", (0.2, 0.1, 0.0), LEVEL)])
    recording = log.open()
    assert recording.odometry_topic == "/tf:odom->base_link"
    assert recording.mount == Mount(0.2, 0.1, 0.0)
    (block,) = recording.blocks()
    np.testing.assert_allclose(block.odometry[:-1, 0], 0.1 * np.arange(1, 10), atol=1e-8)


def test_of_two_children_of_odom_the_one_that_carries_the_laser(log):
    log.scans()
    log.moving("odom", "base_footprint")
    log.moving("odom", "base_link")
    log.transforms([("base_link", "laser", (0.2, 0.0, 0.0), LEVEL)])
    assert log.open().odometry_topic == "/tf:odom->base_link"
    chosen = log.open(odometry_topic="/tf:odom->base_footprint")
    assert chosen.odometry_topic == "/tf:odom->base_footprint"


def test_two_transforms_that_fit_are_listed_with_the_option(log):
    log.scans()
    log.moving("odom", "base_footprint")
    log.moving("odom", "base_link")
    text = refused(log, "2 transforms fit")
    assert "/tf:odom->base_link" in text
    assert "--odom-topic" in text


def test_a_transform_that_is_not_there(log):
    log.scans()
    log.moving("odom", "base_link")
    text = refused(log, "no transform a->b", odometry_topic="/tf:a->b")
    assert "/tf:odom->base_link" in text


def yaw(angle):
    return 0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)


def test_the_mount_is_composed_along_the_edges_either_way(log):
    log.scans()
    log.odometry(child="base_footprint")
    # The laser hangs on a plate that turns by 90 degrees; one edge is told from below.
    log.transforms(
        [
            ("base_footprint", "base_link", (0.0, 0.0, 0.1), LEVEL),
            ("base_link", "plate", (0.3, 0.0, 0.2), yaw(math.pi / 2)),
            ("laser", "plate", (-0.1, 0.0, 0.0), LEVEL),
        ]
    )
    mount = log.open().mount
    np.testing.assert_allclose(mount.pose(), [0.3, 0.1, math.pi / 2], atol=1e-9)
    assert not mount.flipped


def test_a_roll_of_pi_is_a_flipped_mount(log):
    log.scans()
    log.odometry()
    log.transforms([("base_link", "laser", (0.1, 0.0, 0.5), (1.0, 0.0, 0.0, 0.0))])
    recording = log.open()
    assert recording.mount == Mount(0.1, 0.0, 0.0, flipped=True)
    assert any("upside down" in warning for warning in recording.plan.warnings)


def test_a_pitch_of_pi_looks_to_the_rear_and_is_flipped(log):
    log.scans()
    log.odometry()
    log.transforms([("base_link", "laser", (0.1, 0.0, 0.5), (0.0, 1.0, 0.0, 0.0))])
    recording = log.open()
    assert recording.mount.flipped
    assert abs(abs(recording.mount.yaw) - math.pi) < 1e-9
    assert any("rear" in warning for warning in recording.plan.warnings)


def test_a_tilted_laser_is_said(log):
    log.scans()
    log.odometry()
    pitch = (0.0, math.sin(0.1), 0.0, math.cos(0.1))
    log.transforms([("base_link", "laser", (0.1, 0.0, 0.5), pitch)])
    assert any("tilted by 11.5 degrees" in w for w in log.open().plan.warnings)


def test_of_two_tellings_the_last_counts_and_is_said(log):
    log.scans()
    log.odometry()
    log.transforms([("base_link", "laser", (0.1, 0.0, 0.0), LEVEL)])
    log.transforms([("base_link", "laser", (0.3, 0.0, 0.0), LEVEL)], stamp_ns=7)
    recording = log.open()
    assert recording.mount.x == pytest.approx(0.3)
    assert any("given 2 times" in warning for warning in recording.plan.warnings)


def test_static_transforms_late_in_the_log_count_too(log):
    log.scans(count=200)
    log.odometry(count=200)
    log.transforms([("base_link", "laser", (0.1, 0.0, 0.0), LEVEL)], stamp_ns=190 * SECOND)
    assert log.open().mount == Mount(0.1, 0.0, 0.0)


def test_a_transform_on_tf_that_stays_the_same_is_a_mount(log):
    log.scans()
    log.odometry()
    for i in range(10):
        log.transforms([("base_link", "laser", (0.1, 0.0, 0.0), LEVEL)], "/tf", i * SECOND)
    recording = log.open()
    assert recording.mount == Mount(0.1, 0.0, 0.0)
    assert "stays the same" in recording.plan.mount_source


def test_a_transform_that_moves_is_no_mount(log):
    log.scans()
    log.odometry()
    log.moving("base_link", "laser")
    recording = log.open()
    assert recording.mount == Mount()
    assert any("--mount" in warning for warning in recording.plan.warnings)


def test_the_configuration_overrides_the_log(log):
    log.scans()
    log.odometry()
    log.transforms([("base_link", "laser", (0.1, 0.0, 0.0), LEVEL)])
    recording = log.open(mount=MountConfig(x=0.5, yaw=3.0, flipped=True))
    assert recording.mount == Mount(0.5, 0.0, 3.0, flipped=True)


def test_slashes_before_frames_do_not_matter(log):
    log.scans(frame="/laser")
    log.odometry(child="/base_link")
    log.transforms([("base_link", "laser", (0.1, 0.0, 0.0), LEVEL)])
    assert log.open().mount == Mount(0.1, 0.0, 0.0)


# ------------------------------------------------------------------------ clocks


def test_headers_of_zero_give_way_to_the_recorder(log):
    log.scans(stamps=[0] * 10, log=[(i + 1) * SECOND for i in range(10)])
    log.odometry()
    recording = log.open()
    assert recording.plan.clock == "log"
    (block,) = recording.blocks()
    assert block.stamps_ns.tolist() == [(i + 1) * SECOND for i in range(10)]
    assert any("header stamps are unusable" in w for w in recording.report().warnings)


def test_header_clocks_far_apart_give_way_to_the_recorder(log):
    times = [(i + 1) * SECOND for i in range(10)]
    log.scans(stamps=[t + 500 * SECOND for t in times], log=times)
    log.odometry()
    recording = log.open()
    assert recording.plan.clock == "log"
    assert any("500.0 s apart" in w for w in recording.plan.warnings)


def test_header_stamps_are_the_time_and_a_clock_that_disagrees_is_said(log):
    offset = 30 * SECOND
    times = [(i + 1) * SECOND for i in range(10)]
    log.scans(log=[t + offset for t in times])
    readings = [i * SECOND + 5 for i in range(12)]
    log.odometry(count=12, log=[t + offset for t in readings])
    recording = log.open()
    (block,) = recording.blocks()
    assert block.stamps_ns.tolist() == times
    assert any("30.0 s behind the recorder" in w for w in recording.report().warnings)
