"""The documents of a run: exact formats, read back, byte for byte the same."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from samples import (
    covariance,
    report_of,
    same,
    sample_model,
    sample_result,
    sample_trajectory,
    write_sample,
)

from hiermap_cli.documents.checks import (
    UnsoundValueError,
    covariance_fault,
    first_bad_covariance,
    plain,
)
from hiermap_cli.documents.model_file import model_json
from hiermap_cli.documents.model_load import load_model
from hiermap_cli.documents.results import write_result
from hiermap_cli.documents.schema import SHAPES, schema_text, shipped_schema
from hiermap_cli.documents.trajectories import (
    read_covariances,
    write_covariances,
    write_tum,
)
from hiermap_cli.documents.tum import read_tum, stamp_text
from hiermap_cli.mapping.model import Estimate, Metric


@pytest.fixture
def folder(tmp_path):
    return write_sample(tmp_path)


# --- model.json ---


def test_model_is_read_back_bit_for_bit(folder):
    model = sample_model()
    assert same(load_model(folder / "model.json"), model)


def test_model_has_the_keys_of_the_contract(folder):
    model = json.loads((folder / "model.json").read_text())
    assert list(model) == ["format", "version", "environment", "areas", "landmarks"]
    assert (model["format"], model["version"]) == ("hiermap-model", [1, 0])
    assert model["environment"]["areas"][1]["entered_by"] == "D1"
    assert set(model["environment"]["doors"][0]) == {
        "id", "areas", "landmarks", "width", "estimate", "crossings",
    }  # fmt: skip
    assert model["areas"][0]["frame"] == "A1"
    assert model["areas"][0]["robot"]["frame"] == "A1"
    assert model["landmarks"][0]["features"][0]["type"] == 1
    assert model["landmarks"][0]["features"][0]["endless"] == [False, True]
    assert model["landmarks"][2]["features"][0]["kind"] == "point"
    assert np.shape(model["areas"][0]["covariance"]) == (12, 12)


def test_same_model_gives_the_same_bytes():
    assert model_json(sample_model()) == model_json(sample_model())


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_number_that_is_not_finite_is_a_fault(value):
    model = sample_model()
    landmark = replace(model.landmarks[0], utility=value)
    with pytest.raises(UnsoundValueError, match="utility of L1"):
        model_json(replace(model, landmarks=(landmark, *model.landmarks[1:])))


def test_a_joint_covariance_of_the_wrong_size_is_a_fault():
    model = sample_model()
    area = replace(model.areas[0], covariance=np.eye(9))
    with pytest.raises(UnsoundValueError, match="area A1"):
        model_json(replace(model, areas=(area, *model.areas[1:])))


def test_rounding_asymmetry_is_written_symmetric():
    model = sample_model()
    C = model.environment.covariance.copy()
    C[0, 1] *= 1 + 1e-13
    written = json.loads(
        model_json(replace(model, environment=replace(model.environment, covariance=C)))
    )
    C = np.array(written["environment"]["covariance"])
    assert (C == C.T).all()


# --- covariances ---


@pytest.mark.parametrize(
    ("C", "word"),
    [
        (np.diag([1.0, -1e-3, 1.0]), "negative variance"),
        (np.array([[1.0, 1.1], [1.1, 1.0]]), "semidefinite"),
        (np.array([[1.0, 0.5], [0.4, 1.0]]), "symmetric"),
        (np.array([[0.0, 0.1], [0.1, 1.0]]), "variance of zero"),
        (np.array([[1.0, np.nan], [np.nan, 1.0]]), "finite"),
        (np.ones((2, 3)), "square"),
    ],
)
def test_unsound_covariances_are_named(C, word):
    assert word in covariance_fault(C)
    if C.shape[0] == C.shape[1]:
        index, fault = first_bad_covariance(np.stack([np.eye(len(C)), C]))
        assert index == 1
        assert word in fault


@given(st.integers(1, 12), st.integers(0, 12), st.integers(0, 2**32 - 1), st.floats(-6, 6))
@settings(max_examples=60, deadline=None)
def test_any_gram_matrix_is_a_covariance(size, rank, seed, exponent):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(size, rank)) * 10.0 ** rng.uniform(-6, 6, size=(size, 1))
    C = A @ A.T * 10.0**exponent
    assert covariance_fault(C) is None
    assert first_bad_covariance(C[None]) is None


def test_zero_is_a_covariance():
    assert covariance_fault(np.zeros((3, 3))) is None
    assert first_bad_covariance(np.zeros((4, 3, 3))) is None


# --- trajectories ---


@pytest.mark.parametrize(
    ("ns", "text"),
    [
        (0, "0.000000000"),
        (1_700_000_000_123_456_789, "1700000000.123456789"),
        (-1, "-0.000000001"),
        (-1_500_000_000, "-1.500000000"),
    ],
)
def test_stamps_have_nine_exact_decimals(ns, text):
    assert stamp_text(ns) == text


def test_trajectory_is_read_back(folder):
    trajectory = sample_result().trajectory
    back = read_tum(folder / "trajectory.tum")
    assert (back.stamps_ns == trajectory.stamps_ns).all()
    np.testing.assert_allclose(back.poses[:, :2], trajectory.poses[:, :2], atol=1e-9)
    np.testing.assert_allclose(back.poses[:, 2], trajectory.poses[:, 2], atol=1e-11)
    line = (folder / "trajectory.tum").read_text().splitlines()[0].split()
    assert len(line) == 8
    assert line[3:6] == ["0", "0", "0"]


def test_covariances_are_read_back(folder):
    trajectory = sample_result().trajectory
    back = read_covariances(folder / "trajectory_covariance.txt")
    assert (back.stamps_ns == trajectory.stamps_ns).all()
    np.testing.assert_allclose(back.covariances, trajectory.covariances, rtol=1e-13, atol=1e-300)
    assert first_bad_covariance(back.covariances) is None


def test_filter_trajectory_differs_where_it_should(folder):
    final, by_filter = (
        read_tum(folder / "trajectory.tum"),
        read_tum(folder / "trajectory_filter.tum"),
    )
    np.testing.assert_allclose(by_filter.poses[:, 0] - final.poses[:, 0], 0.01, atol=3e-9)


def test_by_the_filter_alone_both_trajectories_are_one(tmp_path):
    result = sample_result()
    write_result(tmp_path, replace(result, trajectory_filter=result.trajectory))
    written = (tmp_path / "trajectory_filter.tum").read_bytes()
    assert written == (tmp_path / "trajectory.tum").read_bytes()
    assert len(written.splitlines()) == len(result.trajectory.stamps_ns)


def test_many_lines_are_written_in_chunks():
    trajectory = sample_trajectory(10_000)
    file = io.StringIO()
    write_tum(file, trajectory.stamps_ns, trajectory.poses)
    lines = file.getvalue().splitlines()
    assert len(lines) == 10_000
    alone = io.StringIO()
    write_tum(alone, trajectory.stamps_ns[8191:8193], trajectory.poses[8191:8193])
    assert lines[8191:8193] == alone.getvalue().splitlines()


def test_a_bad_pose_or_covariance_is_a_fault():
    trajectory = sample_trajectory(5)
    poses = trajectory.poses.copy()
    poses[3, 1] = np.nan
    with pytest.raises(UnsoundValueError):
        write_tum(io.StringIO(), trajectory.stamps_ns, poses)
    with pytest.raises(UnsoundValueError, match="5 stamps"):
        write_tum(io.StringIO(), trajectory.stamps_ns, trajectory.poses[:4])
    covariances = trajectory.covariances.copy()
    covariances[2, 0, 0] = -1.0
    with pytest.raises(UnsoundValueError, match="pose 2"):
        write_covariances(io.StringIO(), trajectory.stamps_ns, covariances)


# --- report.json ---


def test_report_has_the_keys_of_the_contract(folder):
    report = json.loads((folder / "report.json").read_text())
    assert (report["format"], report["version"]) == ("hiermap-report", [1, 0])
    assert set(report["software"]) == {"hiermap", "python", "numpy"}
    assert report["config"]["segmentation"]["min_points"] == 5
    assert report["metrics"][0] == {"name": "matches", "units": "1", "value": 120.0, "n": 140}
    assert report["events"][1]["kind"] == "area_entered"
    assert report["events"][1]["door"] == "D1"
    assert report["events"][1]["t"] == pytest.approx(1_700_000_002.123456789, abs=1e-6)
    assert report["timing"]["filter"] == 0.4


def test_report_refuses_what_is_not_finite():
    with pytest.raises(UnsoundValueError, match="metric m"):
        report_of(sample_result(), metrics=(Metric("m", "1", float("nan"), 1),))


def test_plain_unpacks_numpy_and_names_the_place_of_a_fault():
    assert plain({"a": np.float32(0.5), "b": (np.int64(3), np.array([1.0]))}, "x") == {
        "a": 0.5,
        "b": [3, [1.0]],
    }
    with pytest.raises(UnsoundValueError, match=r"x\.a\[1\]"):
        plain({"a": [1.0, float("inf")]}, "x")
    with pytest.raises(UnsoundValueError, match="set"):
        plain({1, 2}, "x")


# --- schemas ---


@pytest.mark.parametrize("name", SHAPES)
def test_shipped_schema_is_what_the_shapes_say(name):
    assert json.loads(shipped_schema(name)) == json.loads(schema_text(name)), "run `make schemas`"


@pytest.mark.parametrize("name", SHAPES)
def test_shipped_schema_is_a_schema_of_its_draft(name):
    schema = json.loads(shipped_schema(name))
    assert schema["$schema"].endswith("2020-12/schema")
    jsonschema.Draft202012Validator.check_schema(schema)


@pytest.mark.parametrize("name", ["model", "report"])
def test_output_holds_by_an_independent_validator(folder, name):
    validator = jsonschema.Draft202012Validator(json.loads(shipped_schema(name)))
    document = json.loads((folder / f"{name}.json").read_text())
    validator.validate(document)
    del document["format"]
    assert not validator.is_valid(document)


def test_covariance_sample_is_sound():
    C = covariance(np.random.default_rng(0), 6)
    assert covariance_fault(C) is None
    assert Estimate("g", np.zeros(6), C).covariance is C
