from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hiermap_cli.documents.relations import read_relations
from hiermap_cli.documents.tum import read_tum
from hiermap_cli.documents.validate import check_file
from hiermap_cli.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

GOOD = "1.5 1 2 0 0 0 0 1"


def file(folder: Path, text: str) -> Path:
    path = folder / "some.txt"
    path.write_text(text)
    return path


def test_reads_poses_and_skips_comments(tmp_path) -> None:
    half = math.sqrt(0.5)
    text = f"# t x y z qx qy qz qw\n\n{GOOD}\n2.5 -1 3.5 7 0 0 {half} {half}\n"
    track = read_tum(file(tmp_path, text))
    assert track.stamps_ns.tolist() == [1_500_000_000, 2_500_000_000]
    assert track.poses == pytest.approx(np.array([[1, 2, 0], [-1, 3.5, math.pi / 2]]))


def test_stamps_of_today_keep_their_nanoseconds(tmp_path) -> None:
    text = f"-0.000000001 {GOOD[4:]}\n1.751234567e9 {GOOD[4:]}\n1751234567.123456789 {GOOD[4:]}"
    stamps = read_tum(file(tmp_path, text)).stamps_ns
    assert stamps.tolist() == [-1, 1_751_234_567_000_000_000, 1_751_234_567_123_456_789]


def test_a_quaternion_of_few_decimals_and_either_sign(tmp_path) -> None:
    track = read_tum(file(tmp_path, "0 0 0 0 0 0 -0.707 -0.707\n1 0 0 0 0 0 0.7071 0.7071"))
    assert track.poses[:, 2] == pytest.approx([math.pi / 2, math.pi / 2])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "holds no line"),
        ("# only a comment\n", "holds no line"),
        (f"{GOOD}\n1 2 3\n", ":2: 3 columns"),
        (f"# note\n{GOOD}\n2.5 1 x 0 0 0 0 1\n", ":3: 'x' is not a number"),
        (f"{GOOD}\n2.5 nan 0 0 0 0 0 1\n", ":2:"),
        (f"{GOOD}\n1e30 0 0 0 0 0 0 1\n", ":2:"),
        (f"{GOOD}\n2.5 0 0 0 0 0 0 0\n", ":2: the quaternion is zero"),
        (f"{GOOD}\n2.5 0 0 0 0 0 0 3\n", ":2: the quaternion has length 3, not 1"),
        (f"{GOOD}\n1.4 0 0 0 0 0 0 1\n", ":2: the stamp 1.400000000 comes after 1.500000000;"),
        (f"{GOOD}\n1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 2\n", "may not go back (and 1 more)"),
    ],
)
def test_a_bad_line_is_named(tmp_path, text: str, said: str) -> None:
    path = file(tmp_path, text)
    with pytest.raises(InputError) as caught:
        read_tum(path)
    assert str(path) in str(caught.value)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_or_not_text(tmp_path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_tum(tmp_path / "none.tum")
    (tmp_path / "binary.tum").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InputError, match="cannot be read"):
        read_tum(tmp_path / "binary.tum")
    with pytest.raises(InputError, match="cannot be read"):
        read_tum(tmp_path)


def test_reads_relations(tmp_path) -> None:
    path = file(tmp_path, "5.25 6.110267 0.4 -0.02 0 0 0 -0.07\n1 2 0 0 0 0 0 4\n")
    read = read_relations(path)
    assert read.stamps1_ns.tolist() == [5_250_000_000, 1_000_000_000]
    assert read.stamps2_ns.tolist() == [6_110_267_000, 2_000_000_000]
    assert read.poses == pytest.approx(np.array([[0.4, -0.02, -0.07], [0, 0, 4 - 2 * math.pi]]))


@pytest.mark.parametrize(
    ("text", "said"),
    [("1 2 3", ":1: 3 columns"), ("1 1e20 0 0 0 0 0 0", ":1:"), ("1 2 0 0 0 0 0 inf", ":1:")],
)
def test_a_bad_relation_is_named(tmp_path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_relations(file(tmp_path, text))


POSES = "".join(f"{10 + i} {i} 1 0 0 0 0.6 0.8\n" for i in range(5))
PAIRS = "".join(f"{10 + i} {11 + i} 0.4 0.1 0 0 0 {0.1 * i}\n" for i in range(5))


def test_relations_are_no_trajectory_and_a_trajectory_is_no_relations(tmp_path) -> None:
    with pytest.raises(InputError, match=r"holds relations \(t1 t2 .*no trajectory \(t x y z"):
        read_tum(file(tmp_path, PAIRS))
    with pytest.raises(InputError, match=r"holds a trajectory \(t x y z .*no relations \(t1 t2"):
        read_relations(file(tmp_path, POSES))


def test_a_relation_that_turns_by_one_radian_is_one(tmp_path) -> None:
    assert len(read_relations(file(tmp_path, "10 11 0 0 0 0 0 1\n11 12 0 0 0 0 0 -1\n")).poses) == 2


def test_validate_knows_a_text_by_its_shape_and_names_the_first_few_lines(tmp_path) -> None:
    assert check_file(file(tmp_path, PAIRS)) == ("relations (5)", [])
    assert check_file(file(tmp_path, POSES)) == ("trajectory (TUM)", [])
    long = "".join(f"{i} 0 0 0 0 0 0 3\n" for i in range(60)) + "58 0 0 0 0 0 0 1\n"
    (tmp_path / "long.tum").write_text(long)
    faults = check_file(tmp_path / "long.tum").faults
    assert len(faults) == 7
    assert faults[0] == "line 1: the quaternion has length 3, not 1"
    assert faults[5] == "and 55 more lines with this fault"
    assert faults[6].startswith("line 61: the stamp 58.000000000 comes after 59.000000000")
    (tmp_path / "pairs.tum").write_text(PAIRS)
    with pytest.raises(InputError, match="holds relations"):
        check_file(tmp_path / "pairs.tum")
