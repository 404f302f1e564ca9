"""Documents that do not hold are refused, each fault named with its place."""

from __future__ import annotations

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from samples import same, sample_model, write_sample

from hiermap_cli.documents.model_file import model_json
from hiermap_cli.documents.model_load import load_model
from hiermap_cli.documents.validate import check_file
from hiermap_cli.errors import InputError


@pytest.fixture
def folder(tmp_path):
    return write_sample(tmp_path)


def broken(folder, name, change):
    path = folder / name
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    return path


@pytest.mark.parametrize(
    "name",
    ["model.json", "report.json", "trajectory.tum", "trajectory_filter.tum",
     "trajectory_covariance.txt"],
)  # fmt: skip
def test_what_a_run_writes_is_valid(folder, name):
    assert check_file(folder / name).faults == []


def set_at(*path_and_value):
    *path, last, value = path_and_value

    def change(document):
        for key in path:
            document = document[key]
        document[last] = value

    return change


def delete_at(*path):
    def change(document):
        for key in path[:-1]:
            document = document[key]
        del document[path[-1]]

    return change


def one_entry(document):
    document["areas"][0]["covariance"][0][1] += 0.5


def drop_row(document):
    document["areas"][0]["covariance"].pop()


@pytest.mark.parametrize(
    ("change", "where"),
    [
        (set_at("environment", "robot", "mean", [0, 0]), "environment.robot.mean"),
        (set_at("environment", "robot", "mean", [0, 0, 4.0]), "not wrapped"),
        (set_at("environment", "areas", 0, "kind", "hall"), "environment.areas[0].kind"),
        (set_at("environment", "areas", 1, "entered_by", "D9"), "no door"),
        (set_at("environment", "doors", 0, "areas", ["A1", "A7"]), "no area 'A7'"),
        (set_at("environment", "doors", 0, "landmarks", ["L3", "L9"]), "no landmark 'L9'"),
        (set_at("environment", "doors", 0, "width", "0.9"), "environment.doors[0].width"),
        (set_at("areas", 0, "id", "A3"), "environment.areas: lists"),
        (set_at("areas", 0, "landmarks", 0, "estimate", "frame", "g"), "not 'A1'"),
        (set_at("landmarks", 0, "area", "A2"), "landmarks[0]"),
        (set_at("landmarks", 0, "id", "L2"), "more than once"),
        (set_at("landmarks", 0, "binds", ["z"]), "landmarks[0].binds[0]"),
        (set_at("landmarks", 0, "features", 0, "type", 2), "type"),
        (set_at("landmarks", 0, "features", 0, "endless", [0, 1]), "endless"),
        (set_at("landmarks", 0, "observations", 1.5), "observations"),
        (delete_at("landmarks", 0, "utility"), "landmarks[0].utility: is missing"),
        (delete_at("areas"), "areas: is missing"),
        (one_entry, "areas[0].covariance: is not symmetric"),
        (drop_row, "areas[0].covariance: is 11 x 12"),
        (set_at("environment", "robot", "covariance", [[1, 0, 0], [0, 1, 0], [0, 0, 1]]), "block"),
    ],
)
def test_each_fault_of_a_model_is_found_and_named(folder, change, where):
    path = broken(folder, "model.json", change)
    verdict = check_file(path)
    assert any(where in fault for fault in verdict.faults), verdict.faults
    with pytest.raises(InputError) as caught:
        load_model(path)
    assert "\n" not in str(caught.value)


def test_a_newer_major_version_says_so(folder):
    path = broken(folder, "model.json", set_at("version", [2, 0]))
    for read in (load_model, check_file):
        with pytest.raises(InputError, match="newer"):
            read(path)


def test_a_newer_minor_version_and_further_keys_are_read(folder):
    def change(document):
        document["version"] = [1, 7]
        document["new"] = {"a": 1}
        document["landmarks"][0]["colour"] = "red"

    path = broken(folder, "model.json", change)
    assert check_file(path).faults == []
    assert same(load_model(path), sample_model())


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "empty"),
        ("{", "no JSON"),
        ("[1, 2]", "no document"),
        ('{"format": "x"}', "known are"),
        ('{"format": "hiermap-model"}', "version"),
    ],
)
def test_what_is_no_document_is_refused_in_one_line(tmp_path, text, word):
    path = tmp_path / "model.json"
    path.write_text(text)
    with pytest.raises(InputError, match=word) as caught:
        check_file(path)
    assert "\n" not in str(caught.value)


def test_a_number_that_is_not_finite_is_named_with_its_place(tmp_path):
    path = tmp_path / "model.json"
    path.write_text('{"format": "hiermap-model", "version": [1, 0], "x": NaN}')
    faults = check_file(path).faults
    assert faults[0] == "x: is nan, not a finite number"


def test_tum_rules(tmp_path):
    path = tmp_path / "a.tum"
    path.write_text("1.0 0 0 0 0 0 0 1\n0.5 0 0 0 0 0 0 1\n2.0 0 0 0 0 0 0.1 1\n")
    faults = check_file(path).faults
    assert len(faults) == 2
    (stamp,) = [fault for fault in faults if "line 2" in fault]
    assert "stamp" in stamp
    (quaternion,) = [fault for fault in faults if "line 3" in fault]
    assert "quaternion" in quaternion


def test_covariance_file_rules(tmp_path):
    path = tmp_path / "trajectory_covariance.txt"
    path.write_text("1.0 1 0 0 1 0 1\n2.0 1 2 0 1 0 1\n")
    (fault,) = check_file(path).faults
    assert "t = 2.0" in fault
    path.write_text("1.0 1 0\n")
    with pytest.raises(InputError, match="3 columns"):
        check_file(path)


def test_an_eval_that_contradicts_its_limits(tmp_path):
    path = tmp_path / "eval.json"
    limit = {"metric": "ate_rmse", "limit": "<=0.2", "value": None, "passed": True}
    document = {"format": "hiermap-eval", "version": [1, 0], "passed": True, "metrics": []}
    path.write_text(json.dumps(document | {"limits": [limit]}))
    assert "without a value" in check_file(path).faults[0]
    path.write_text(json.dumps(document | {"limits": [limit | {"value": 0.1}]}))
    assert check_file(path).faults == []


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_damaged_documents_never_break_the_reader(tmp_path_factory, data):
    text = bytearray(model_json(sample_model()))
    at = data.draw(st.integers(0, len(text) - 1))
    if data.draw(st.booleans()):
        text = text[:at]
    else:
        text[at] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("d") / "model.json"
    path.write_bytes(bytes(text))
    try:
        load_model(path)
        check_file(path)
    except InputError as error:
        assert "\n" not in str(error)
