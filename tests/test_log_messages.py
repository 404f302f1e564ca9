"""Messages decoded by hand, held against rosbags; messages written, read by rosbags."""

from __future__ import annotations

import json
import math
import struct

import foxglove_cases as fox
import log_cases as cases
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hiermap_cli.errors import InputError, UsageError
from hiermap_cli.logs import cdr_write, foxglove, ros_decode, ros_definitions
from hiermap_cli.logs.decoders import DECODE_ERRORS, MEANINGS
from hiermap_cli.logs.mcap_writer import RosMcapWriter
from hiermap_cli.logs.records import LaserGeometry, Mount, Odometry, Transform

SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
TF = "tf2_msgs/msg/TFMessage"

single = st.floats(width=32, allow_nan=True, allow_infinity=True)
double = st.floats(allow_nan=False, allow_infinity=False)
stamp = st.integers(0, 2**31 * 10**9 - 1)
name = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)


def serialised(message, kind, wire):
    if wire == "ros1":
        return bytes(cases.STORE1.serialize_ros1(message, kind))
    return bytes(cases.STORE2.serialize_cdr(message, kind, little_endian=wire == "little"))


def deserialised(data, kind, wire):
    if wire == "ros1":
        return cases.STORE1.deserialize_ros1(data, kind)
    return cases.STORE2.deserialize_cdr(data, kind)


def store(wire):
    return cases.STORE1 if wire == "ros1" else cases.STORE2


WIRES = ["little", "big", "ros1"]


@pytest.mark.parametrize("wire", WIRES)
@settings(max_examples=60, deadline=None)
@given(
    stamp_ns=stamp,
    frame=name,
    fields=st.lists(single, min_size=7, max_size=7),
    ranges=st.lists(single, max_size=40),
    intensities=st.lists(single, max_size=3),
)
def test_laser_scans_are_byte_for_byte_those_of_rosbags(
    wire, stamp_ns, frame, fields, ranges, intensities
):
    kinds = store(wire).types
    names = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time")
    message = kinds[SCAN](
        header=cases.header(store(wire), stamp_ns, frame),
        **dict(zip((*names, "range_min", "range_max"), fields, strict=True)),
        ranges=np.array(ranges, dtype=np.float32),
        intensities=np.array(intensities, dtype=np.float32),
    )
    data = serialised(message, SCAN, wire)
    expected = deserialised(data, SCAN, wire)
    decode = ros_decode.laser_scan_ros1 if wire == "ros1" else ros_decode.laser_scan_cdr
    (raw,) = decode(data)
    at = expected.header.stamp
    assert raw.stamp_ns == at.sec * 10**9 + at.nanosec
    assert raw.frame == expected.header.frame_id
    assert raw.ranges.astype("<f4").tobytes() == expected.ranges.astype("<f4").tobytes()
    for ours, theirs in (
        (raw.angle_min, expected.angle_min),
        (raw.angle_increment, expected.angle_increment),
        (raw.range_min, expected.range_min),
    ):
        assert struct.pack("<d", ours) == struct.pack("<d", theirs)


@pytest.mark.parametrize("wire", WIRES)
@settings(max_examples=60, deadline=None)
@given(stamp_ns=stamp, frame=name, child=name, x=double, y=double, theta=st.floats(-3.1, 3.1))
def test_odometry_is_byte_for_byte_that_of_rosbags(wire, stamp_ns, frame, child, x, y, theta):
    message = cases.odometry_message(store(wire), stamp_ns, (x, y, theta), child=child)
    message.header.frame_id = frame
    data = serialised(message, ODOMETRY, wire)
    expected = deserialised(data, ODOMETRY, wire)
    decode = ros_decode.odometry_ros1 if wire == "ros1" else ros_decode.odometry_cdr
    (reading,) = decode(data)
    at, pose = expected.header.stamp, expected.pose.pose
    assert reading.stamp_ns == at.sec * 10**9 + at.nanosec
    assert (reading.frame, reading.child) == (frame, child)
    assert struct.pack("<2d", reading.x, reading.y) == struct.pack(
        "<2d", pose.position.x, pose.position.y
    )
    q = pose.orientation
    assert math.isclose(reading.theta, 2.0 * math.atan2(q.z, q.w), abs_tol=1e-12)


@pytest.mark.parametrize("wire", WIRES)
@settings(max_examples=40, deadline=None)
@given(stamp_ns=stamp, frames=st.lists(st.tuples(name, name), max_size=4), x=double)
def test_transforms_are_those_of_rosbags(wire, stamp_ns, frames, x):
    edges = tuple((a, b, (x, 1.0, -2.0), (0.1, 0.2, 0.3, 0.9)) for a, b in frames)
    data = serialised(cases.tf_message(store(wire), stamp_ns, edges), TF, wire)
    decode = ros_decode.tf_message_ros1 if wire == "ros1" else ros_decode.tf_message_cdr
    assert decode(data) == [Transform(stamp_ns, *edge) for edge in edges]


def test_the_second_version_of_cdr_aligns_doubles_to_four():
    data = cdr_write.odometry(5, "odom", "base_link", (1.0, 2.0, 0.5), None)
    head = len(cdr_write.text("odom")) + 8
    child = cdr_write.text("base_link")
    at = 4 + head + -head % 4 + len(child)
    aligned_to_8, aligned_to_4 = at + (4 - at) % 8, at + -at % 4
    assert aligned_to_8 != aligned_to_4
    second = b"\x00\x07" + data[2:aligned_to_4] + data[aligned_to_8:]
    assert ros_decode.odometry_cdr(second) == ros_decode.odometry_cdr(data)


@pytest.mark.parametrize("decode", [meaning.decode for meaning in MEANINGS.values()])
@settings(max_examples=60, deadline=None)
@given(data=st.binary(max_size=200))
def test_bytes_that_are_no_message_give_a_decoding_error_or_values(decode, data):
    try:
        values = decode(data)
    except DECODE_ERRORS:
        return
    assert isinstance(values, list)


@pytest.mark.parametrize("packed", [True, False])
def test_protobuf_ranges_may_be_packed_or_not(packed):
    (raw,) = foxglove.laser_scan_protobuf(fox.protobuf_scan(7, cases.ranges(3), packed=packed))
    np.testing.assert_array_equal(raw.ranges, cases.ranges(3).astype(np.float32))
    assert raw.stamp_ns == 7


def test_protobuf_times_before_the_epoch_and_unknown_fields():
    before = fox.varint((1 << 64) - 2)  # -2 seconds
    timestamp = fox.field(1, 0, before) + fox.field(2, 0, fox.varint(500))
    unknown = fox.field(15, 5, b"abcd") + fox.nested(14, b"xyz")
    data = fox.nested(1, timestamp) + fox.nested(2, b"odom") + unknown
    (reading,) = foxglove.pose_in_frame_protobuf(data)
    assert reading == Odometry(-2 * 10**9 + 500, 0.0, 0.0, 0.0, frame="odom")


@pytest.mark.parametrize(
    "when", [{"seconds": 3, "nanos": 5}, {"sec": 3, "nanosec": 5}, "1970-01-01T00:00:03.000000005Z"]
)
def test_json_times_come_in_several_spellings(when):
    message = {"timestamp": when, "frame_id": "odom", "pose": {"position": {"x": 1.5}}}
    (reading,) = foxglove.pose_in_frame_json(json.dumps(message).encode())
    assert reading == Odometry(3 * 10**9 + 5, 1.5, 0.0, 0.0, frame="odom")


def test_a_scan_with_a_pose_of_its_own_has_a_frame_of_its_own():
    message = json.loads(fox.json_scan(5, [1.0, 2.0]))
    message["pose"]["position"]["x"] = 0.3
    edge, raw = foxglove.laser_scan_json(json.dumps(message).encode())
    assert edge == Transform(5, "laser", "laser#scan", (0.3, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    assert raw.frame == "laser#scan"


@pytest.mark.parametrize("kind", [SCAN, ODOMETRY, TF])
def test_the_written_definitions_are_those_of_ros_2(kind):
    own = get_typestore(Stores.EMPTY)
    own.register(get_types_from_msg(ros_definitions.DEFINITIONS[kind], kind))
    assert own.hash_rihs01(kind) == cases.STORE2.hash_rihs01(kind)


def written(path):
    with path.open("rb") as file:
        return [
            (channel.topic, message.log_time, cases.STORE2.deserialize_cdr(message.data, s.name))
            for s, channel, message in make_reader(file, validate_crcs=True).iter_messages()
        ]


def test_what_is_written_rosbags_reads(tmp_path):
    path = tmp_path / "x.mcap"
    laser = LaserGeometry(-1.5, 0.25, 4, 0.125, 30.0)
    with RosMcapWriter(path, Mount(0.1, -0.2, 0.3, flipped=True)) as writer:
        writer.odometry(10**9 + 5, (1.0, 2.0, 3.0), np.arange(9).reshape(3, 3))
        writer.scan(10**9 + 7, [1.0, np.inf, np.nan, 2.5], laser)
    (topic_tf, log_tf, tf), (topic_odom, _, odom), (topic_scan, log_scan, scan) = written(path)
    assert (topic_tf, topic_odom, topic_scan) == ("/tf_static", "/odom", "/scan")
    assert (log_tf, log_scan) == (10**9 + 5, 10**9 + 7)
    (edge,) = tf.transforms
    assert (edge.header.frame_id, edge.child_frame_id) == ("base_link", "laser")
    assert (edge.transform.translation.x, edge.transform.translation.y) == (0.1, -0.2)
    assert odom.child_frame_id == "base_link"
    assert odom.pose.covariance.reshape(6, 6)[5, 1] == 7.0
    assert math.isclose(
        2 * math.atan2(odom.pose.pose.orientation.z, odom.pose.pose.orientation.w), 3
    )
    np.testing.assert_array_equal(scan.ranges, np.float32([1.0, np.inf, np.nan, 2.5]))
    assert (scan.angle_min, scan.angle_max, scan.range_max) == (-1.5, -0.75, 30.0)
    assert scan.header.stamp.nanosec == 7


@given(
    st.floats(1e-200, 10.0)
    | st.floats(-10.0, -1e-200)
    | st.integers(-3_200_000, 3_200_000).map(lambda n: n * 1e-6)
)
def test_a_written_heading_is_read_back_to_the_last_bit(theta):
    data = cdr_write.odometry(5, "odom", "base_link", (0.0, 0.0, theta), None)
    (reading,) = ros_decode.odometry_cdr(data)
    assert reading.theta == math.remainder(theta, 2.0 * math.pi)


@pytest.mark.parametrize("mount", [Mount(), Mount(0.2, 0.1, -2.0), Mount(0, 0, 3.0, flipped=True)])
def test_a_written_mount_is_read_back(tmp_path, mount):
    from hiermap_cli.config import InputConfig
    from hiermap_cli.logs.recording import open_recording

    path = tmp_path / "x.mcap"
    with RosMcapWriter(path, mount) as writer:
        writer.odometry(10**9, (0.0, 0.0, 0.0))
        writer.scan(10**9, [1.0] * 4, LaserGeometry(-1.5, 0.25, 4, 0.0, 30.0))
    recording = open_recording([path], InputConfig())
    assert recording.mount.flipped == mount.flipped
    np.testing.assert_allclose(recording.mount.pose(), mount.pose(), atol=1e-12)


def test_the_same_messages_give_the_same_bytes(tmp_path):
    paths = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for path in paths:
        with RosMcapWriter(path, Mount()) as writer:
            for i in range(3000):
                writer.odometry(i * 10**7, (0.01 * i, 0.0, 0.001 * i))
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_a_writer_that_fails_leaves_nothing(tmp_path):
    path = tmp_path / "x.mcap"

    def fail():
        with RosMcapWriter(path, Mount()) as writer:
            writer.odometry(5, (0.0, 0.0, 0.0))
            writer.odometry(2**70, (0.0, 0.0, 0.0))

    with pytest.raises(InputError, match="does not fit"):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_exists_is_replaced_only_when_told(tmp_path):
    path = tmp_path / "x.mcap"
    path.write_text("precious")
    with pytest.raises(UsageError, match="exists already"):
        RosMcapWriter(path, None).__enter__()
    assert path.read_text() == "precious"
    with RosMcapWriter(path, None, overwrite=True) as writer:
        writer.odometry(5, (0.0, 0.0, 0.0))
    assert len(written(path)) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["x.mcap"]


def test_a_folder_that_is_not_there_is_wrong_usage(tmp_path):
    with pytest.raises(UsageError, match=r"cannot be written.*another place with -o"):
        RosMcapWriter(tmp_path / "none" / "x.mcap", None).__enter__()
