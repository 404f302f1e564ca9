"""The commands eval, compare and reference, from files to exit status."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from eval_cases import (
    MODEL,
    REFERENCE,
    TRACK,
    write_map,
    write_reference,
    write_run,
    write_truth,
)
from large_building import boxes, reference_of

from hiermap_cli.commands.main import cli
from hiermap_cli.documents.eval_file import read_eval
from hiermap_cli.documents.reference import ReferenceMap, read_reference
from hiermap_cli.documents.validate import check_file


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("place")
    write_run(folder / "run")
    write_truth(folder)
    write_reference(folder)
    write_map(folder)
    (folder / "relations.txt").write_text("0.0 1.0 0 0 0 0 0 0.5\n0.5 500000 0 0 0 0 0 0\n")
    return folder


@pytest.fixture(autouse=True)
def no_ci(monkeypatch):
    monkeypatch.delenv("GITHUB_STEP_SUMMARY", raising=False)


def run(*arguments):
    return CliRunner().invoke(cli, [str(a) for a in arguments], catch_exceptions=False)


def evaluate(place, tmp_path, *more):
    out = tmp_path / "eval.json"
    done = run(
        "eval", place / "run", "--reference", place / "reference.json",
        "--trajectory", place / "truth.tum", "--relations", place / "relations.txt",
        "-o", out, *more,
    )  # fmt: skip
    return done, out


def test_a_perfect_run_passes_its_limits(place, tmp_path):
    done, out = evaluate(place, tmp_path, "--limit", "ate_rmse<=0.01", "--limit", "door_recall>=1")
    assert done.exit_code == 0, done.stderr
    assert not check_file(out).faults
    document = json.loads(out.read_bytes())
    assert document["passed"] is True
    assert [limit["passed"] for limit in document["limits"]] == [True, True]
    values = {metric["name"]: metric["value"] for metric in document["metrics"]}
    assert values["relations_missing"] == 1.0
    assert values["corner_recall"] == values["area_f1_iou50"] == 1.0
    assert "limit ate_rmse<=0.01: holds" in done.stderr
    assert done.stdout == ""


def test_a_missed_limit_ends_with_status_3_and_everything_is_written(place, tmp_path):
    summary, junit = tmp_path / "summary.md", tmp_path / "junit.xml"
    limits = tmp_path / "limits.yaml"
    limits.write_text('limits: ["ate_rmse<=0.1", "occupancy_agreement>=0.5"]\n')
    done, out = evaluate(
        place, tmp_path, "--limits", limits, "--summary", summary, "--junit", junit, "--json"
    )
    assert done.exit_code == 3
    assert json.loads(done.stdout)["passed"] is False
    assert json.loads(out.read_bytes()) == json.loads(done.stdout)
    assert "| occupancy_agreement | not measured |" in summary.read_text()
    said = "occupancy_agreement>=0.5: could not be measured: the reference has no map of cells"
    assert said.replace(">", "&gt;") in junit.read_text()
    assert f"limit {said}" in done.stderr


def test_a_limit_on_a_misspelt_metric_is_missed_and_the_right_name_said(place, tmp_path):
    done, _ = evaluate(place, tmp_path, "--limit", "ate_rmsee<=0.1")
    assert done.exit_code == 3
    assert "no metric of that name; did you mean ate_rmse?" in done.stderr


def test_the_reason_of_status_3_is_one_line_however_quiet(place, tmp_path):
    done, _ = evaluate(
        place, tmp_path, "-q", "--limit", "ate_rms<=3", "--limit", "ate_max<=9", "--limit",
        "ate_max<0",
    )  # fmt: skip
    assert done.exit_code == 3
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("hiermap: ate_rms<=3: could not be measured: ")
    assert "did you mean ate_rmse?" in done.stderr
    assert "ate_max<0: missed" in done.stderr
    assert "ate_max<=9" not in done.stderr


def test_where_ci_offers_a_summary_it_is_added_to(place, tmp_path, monkeypatch):
    offered = tmp_path / "step"
    offered.write_text("before\n")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(offered))
    done, _ = evaluate(place, tmp_path, "-q")
    assert done.exit_code == 0
    text = offered.read_text()
    assert text.startswith("before\n### hiermap eval: run: no limits\n")
    assert "| ate_rmse | 0 | m |" in text
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(tmp_path / "no" / "such"))
    done, _ = evaluate(place, tmp_path, "-q")
    assert done.exit_code == 0
    assert "no job summary was written" in done.stderr


def test_the_picture_shows_what_is_off(place, tmp_path):
    env = MODEL.environment
    lost = replace(MODEL, environment=replace(env, doors=env.doors[1:]))
    write_run(tmp_path / "worse", lost)
    picture = tmp_path / "overlay.svg"
    done = run(
        "eval", tmp_path / "worse", "--reference", place / "reference.json",
        "--trajectory", place / "truth.tum", "--overlay", picture,
    )  # fmt: skip
    assert done.exit_code == 0
    assert "missed doors: D0" in done.stderr
    text = picture.read_text()
    assert 'class="d m"' in text
    assert ">D0<" in text
    assert done.stderr.count("missed edges") == 1


def test_the_map_of_another_building_is_warned_of_however_quiet(place, tmp_path):
    other = write_reference(tmp_path, reference_of(boxes(2, 6)), "other.json")
    out, picture = tmp_path / "eval.json", tmp_path / "overlay.svg"
    summary, junit = tmp_path / "summary.md", tmp_path / "junit.xml"
    arguments = (
        "eval", place / "run", "--reference", other, "-o", out, "--overlay", picture,
        "--summary", summary, "--junit", junit, "-q",
    )  # fmt: skip
    done = run(*arguments)
    assert done.exit_code == 0
    nothing, not_drawn = done.stderr.splitlines()
    assert nothing.startswith(f"warning: {other}: nothing was measured on this map: two places fit")
    assert not_drawn == f"warning: {picture}: not drawn: the run was not put onto the reference map"
    assert not picture.exists()
    assert [f"warning: {one}" for one in read_eval(out).warnings] == [nothing]
    assert not check_file(out).faults
    assert "**Warning:**" in summary.read_text()
    assert "nothing was measured on this map" in junit.read_text()
    assert run(*arguments, "--limit", "door_recall>=0.1").exit_code == 3


def test_a_reference_that_holds_nothing_is_warned_of(place, tmp_path):
    empty = write_reference(tmp_path, ReferenceMap(), "empty.json")
    arguments = ("eval", place / "run", "--reference", empty, "-o", tmp_path / "e.json", "-q")
    done = run(*arguments, "--trajectory", place / "truth.tum")
    assert done.exit_code == 0
    nothing = f"warning: {empty}: nothing was measured on this map: "
    assert done.stderr == f"{nothing}it has nothing to measure\n"
    done = run(*arguments)
    assert done.stderr.startswith(f"{nothing}the reference has neither walls nor areas")


def test_a_run_that_is_measured_is_not_warned_of(place, tmp_path):
    done, out = evaluate(place, tmp_path, "-q")
    assert (done.exit_code, done.stderr, read_eval(out).warnings) == (0, "", ())


def test_a_map_of_cells_and_its_rooms(place, tmp_path):
    out, picture = tmp_path / "eval.json", tmp_path / "overlay.svg"
    done = run(
        "eval", place / "run", "--reference", place / "map.yaml", "--rooms", place / "rooms.png",
        "-o", out, "--overlay", picture, "--limit", "occupancy_agreement>=0.9",
    )  # fmt: skip
    assert done.exit_code == 0, done.stderr
    values = read_eval(out).values()
    assert values["area_f1_iou50"] == 1.0
    assert values["door_recall"] == values["topology_recall"] == 1.0
    assert "data:image/png;base64," in picture.read_text()


def test_reference_from_a_map(place, tmp_path):
    out = tmp_path / "made.json"
    arguments = ("reference", place / "map.yaml", "--rooms", place / "rooms.png", "-o", out)
    done = run(*arguments)
    assert done.exit_code == 0, done.stderr
    made = read_reference(out)
    assert len(made.areas) == len(REFERENCE.areas)
    assert len(made.doors) == len(REFERENCE.doors)
    wanted = sorted(tuple(np.round(0.5 * (d.p1 + d.p2), 1)) for d in REFERENCE.doors)
    got = sorted(tuple(np.round(0.5 * (d.p1 + d.p2), 1)) for d in made.doors)
    assert np.abs(np.array(wanted) - np.array(got)).max() <= 0.11
    assert {area.kind for area in made.areas} == {"room", "corridor"}
    again = run(*arguments)
    assert (again.exit_code, "exists already" in again.stderr) == (2, True)
    visited = run(*arguments, "--force", "--trajectory", place / "truth.tum")
    assert visited.exit_code == 0
    judged = run(
        "eval", place / "run", "--reference", out, "--trajectory", place / "truth.tum",
        "-o", tmp_path / "e.json", "--limit", "wall_rmse<=0.05", "--limit", "area_f1_iou50>=1",
    )  # fmt: skip
    assert judged.exit_code == 0, judged.stderr


def test_pgm_is_read_as_png_is(place, tmp_path):
    text = (place / "map.yaml").read_text().replace("map.png", "map.pgm")
    (place / "pgm.yaml").write_text(text)
    for name in ("map", "pgm"):
        done = run("reference", place / f"{name}.yaml", "-o", tmp_path / f"{name}.json", "-q")
        assert done.exit_code == 0
    assert (tmp_path / "map.json").read_bytes() == (tmp_path / "pgm.json").read_bytes()


def spoilt(**changes):
    def spoil(document):
        return document | changes

    return spoil


def crossing(document):
    document["areas"][0]["polygon"] = [[0, 0], [4, 4], [4, 0], [0, 4]]
    return document


def not_a_number(document):
    document["walls"][3][1] = float("nan")
    return document


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (spoilt(version=[2, 0]), "version is [2, 0], this program reads [1, ...]"),
        (spoilt(format="other"), "format is 'other'"),
        (not_a_number, "walls[3]: is not [x1, y1, x2, y2] in finite numbers"),
        (crossing, "areas[0].polygon: crosses itself (self-intersection) at [2, 2]"),
    ],
)
def test_a_bad_reference_is_status_1_and_says_what_and_where(place, tmp_path, spoil, said):
    document = spoil(json.loads((place / "reference.json").read_text()))
    bad = tmp_path / "bad.json"
    bad.write_text(json.dumps(document))
    done = run("eval", place / "run", "--reference", bad, "-o", tmp_path / "eval.json")
    assert done.exit_code == 1
    assert len(done.stderr.splitlines()) == 1
    assert str(bad) in done.stderr
    assert said in done.stderr
    assert not (tmp_path / "eval.json").exists()
    if document["format"] == "hiermap-reference" and document["version"] == [1, 0]:
        checked = run("validate", bad)
        assert checked.exit_code == 1
        assert checked.stderr.startswith(f"{bad}: {said}")


def test_a_damaged_truth_or_one_of_another_kind_is_status_1(place, tmp_path):
    lines = (place / "truth.tum").read_text().splitlines()
    swapped, scaled, pairs = (tmp_path / name for name in ("swapped.tum", "scaled.tum", "r.txt"))
    swapped.write_text("\n".join([lines[0], lines[2], lines[1], *lines[3:]]))
    scaled.write_text("\n".join(f"{' '.join(line.split()[:4])} 0 0 0 3" for line in lines))
    pairs.write_text("100 101 0.5 0 0 0 0 0.2\n101 102 0.5 0 0 0 0 0.1\n")
    for option, path, said in (
        ("--trajectory", swapped, "swapped.tum:3: the stamp "),
        ("--trajectory", scaled, "scaled.tum:1: the quaternion has length 3, not 1"),
        ("--trajectory", pairs, "holds relations (t1 t2 x y z roll pitch yaw), no trajectory"),
        ("--relations", place / "truth.tum", "holds a trajectory (t x y z qx qy qz qw), no rel"),
    ):
        done = run("eval", place / "run", option, path, "-o", tmp_path / "e.json")
        assert done.exit_code == 1
        assert len(done.stderr.splitlines()) == 1
        assert str(path) in done.stderr
        assert said in done.stderr
        assert not (tmp_path / "e.json").exists()


def test_no_time_in_common_is_status_1(place, tmp_path):
    late = write_truth(tmp_path, stamps_ns=TRACK.stamps_ns + 10**13)
    done = run("eval", place / "run", "--trajectory", late, "-o", tmp_path / "e.json")
    assert done.exit_code == 1
    assert str(late) in done.stderr
    assert "no two stamps lie within 0.5 s" in done.stderr


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("image: none.png\nresolution: 0.1\norigin: [0, 0, 0]\n", "no such image"),
        ("image: map.png\nresolution: 0\norigin: [0, 0, 0]\n", "resolution"),
        ("image: map.png\nresolution: 0.1\n", "origin"),
        ("image: truth.tum\nresolution: 0.1\norigin: [0, 0, 0]\n", "cannot be read as an image"),
    ],
)
def test_a_bad_map_is_status_1(place, tmp_path, text, said):
    path = place / "bad.yaml"
    path.write_text(text)
    done = run("eval", place / "run", "--reference", path, "-o", tmp_path / "e.json")
    assert done.exit_code == 1
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_rooms_of_another_size_are_refused(place, tmp_path):
    from PIL import Image

    Image.new("RGB", (5, 5), (9, 9, 9)).save(tmp_path / "small.png")
    done = run(
        "eval", place / "run", "--reference", place / "map.yaml", "--rooms", tmp_path / "small.png"
    )
    assert done.exit_code == 1
    assert "has 5 x 5 pixels, the map" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "give at least one of --reference, --trajectory and --relations"),
        (("--limit", "ate_rmse", "--trajectory", "x"), "'ate_rmse' is no limit"),
        (("--reference", "r.json", "--rooms", "i.png"), "--rooms is an image that lies on a map"),
        (("--trajectory", "t.tum", "--overlay", "o.svg"), "--overlay draws the model over a"),
        (("--reference", "r.json", "--overlay", "o.png"), "o.png: --overlay writes SVG: give it"),
    ],
)
def test_wrong_usage_is_status_2(place, arguments, said):
    done = run("eval", place / "run", *arguments)
    assert done.exit_code == 2
    assert said in done.stderr


def test_faults_of_a_file_of_limits_are_all_listed(place, tmp_path):
    limits = tmp_path / "limits.yaml"
    limits.write_text('limits: ["ate_rmse", "door_recall>=1", "x<=nan"]\n')
    done, _ = evaluate(place, tmp_path, "--limits", limits)
    assert done.exit_code == 2
    places = [": ".join(line.split(": ")[2:4]) for line in done.stderr.splitlines()]
    assert places == ["line 1: limits[0]", "line 1: limits[2]"]


def test_a_folder_without_a_run_is_status_1(tmp_path):
    done = run("eval", tmp_path, "--trajectory", "x.tum")
    assert done.exit_code == 1
    assert "no such file" in done.stderr


def test_compare_holds_a_candidate_to_a_baseline(place, tmp_path):
    noise = np.random.default_rng(1).normal(0.0, 0.05, TRACK.poses.shape)
    write_run(tmp_path / "worse", track=replace(TRACK, poses=TRACK.poses + noise))
    for name, folder in (("good", place / "run"), ("bad", tmp_path / "worse")):
        out = tmp_path / f"{name}.json"
        done = run("eval", folder, "--trajectory", place / "truth.tum", "-o", out, "-q")
        assert done.exit_code == 0
    good, bad = tmp_path / "good.json", tmp_path / "bad.json"
    junit, summary = tmp_path / "j.xml", tmp_path / "s.md"
    worse = run(
        "compare", good, bad, "--fail-if", "ate_rmse>+0.01", "--fail-if", "ate_rmse>1",
        "--junit", junit, "--summary", summary, "--json",
    )  # fmt: skip
    assert worse.exit_code == 3
    rules = json.loads(worse.stdout)["rules"]
    assert [rule["passed"] for rule in rules] == [False, True]
    assert "**failed**" in summary.read_text()
    assert junit.read_text().count("<failure") == 1
    assert run("compare", bad, good, "--fail-if", "ate_rmse>5%").exit_code == 0
    assert run("compare", good, good, "--fail-if", "ate_rmse>0%").exit_code == 0
    assert run("compare", good, bad, "--fail-if", "door_recall<-1%").exit_code == 3
    quiet = run(
        "compare", good, bad, "--fail-if", "ate_rmse>0.01", "--fail-if", "ate_rmse<-1", "-q"
    )
    assert quiet.exit_code == 3
    assert len(quiet.stderr.splitlines()) == 1
    assert quiet.stderr.startswith("hiermap: ate_rmse>0.01: FAILED, ")
    assert run("compare", good, bad, "--fail-if", "ate_rmse<5%").exit_code == 2
    assert run("compare", good, tmp_path / "none.json").exit_code == 1
    assert Path(good).exists()
