"""The tables of thresholds moved and of parts left out, by their parts that are not long."""

from __future__ import annotations

import json
import math
import sys

import pytest
from test_developer_scripts import load

from hiermap_cli.config import Config
from hiermap_cli.estimation.association import chi_square


@pytest.fixture(scope="module")
def scripts():
    sensitivity, ablation = load("sensitivity"), load("ablation")
    return sys.modules["variants"], sensitivity, ablation  # as its workers will import it


def by_name(sensitivity):
    return {str(one): one for one in sensitivity.thresholds(Config())}


def value_of(config, name):
    section, key = name.split(".")
    return getattr(getattr(config, section), key)


def test_thresholds_are_all_numbers_of_their_sections_and_no_switches(scripts):
    names = by_name(scripts[1])
    assert {"association.gate", "areas.min_area", "loops.min_overlap", "refine.scales"} <= set(
        names
    )
    assert len(names) > 100
    switches = {"loops.enabled", "refine.enabled", "association.joint"}
    assert not switches & set(names)
    assert all(value_of(Config(), name) == one.value for name, one in names.items())


@pytest.mark.parametrize(
    ("name", "less", "more"),
    [
        ("loops.min_overlap", 3.2, 4.8),
        ("loops.least_steps", 1, 3),  # a whole number goes to the next one at least
        ("loops.partners", 10, 14),
        ("loops.min_pairs", None, 2),  # where it stands at its bound it stays
        ("relocation.second", 0.68, 1.0),  # a share ends at its bound
        ("refine.scales", (2.0, 0.8), (3.0, 1.2)),
    ],
)
def test_one_threshold_is_moved_and_nothing_else(scripts, name, less, more):
    sensitivity = scripts[1]
    threshold = by_name(sensitivity)[name]
    for factor, wanted in ((0.8, less), (1.2, more)):
        config = sensitivity.moved(threshold, factor)
        if wanted is None:
            assert config is None
            continue
        assert value_of(config, name) == pytest.approx(wanted)
        back = config.model_dump()
        back[threshold.section][threshold.key] = threshold.value
        assert Config.model_validate(back) == Config()


def test_a_gate_is_moved_as_its_chi_square(scripts):
    sensitivity = scripts[1]
    threshold = by_name(sensitivity)["association.gate"]
    for factor in (0.8, 1.2):
        gate = sensitivity.moved(threshold, factor).association.gate
        assert chi_square(gate, 2) == pytest.approx(factor * chi_square(0.999, 2))


def test_every_threshold_can_be_moved_one_way_at_least(scripts):
    sensitivity = scripts[1]
    for threshold in sensitivity.thresholds(Config()):
        assert any(sensitivity.moved(threshold, factor) for factor in (0.8, 1.2)), str(threshold)


@pytest.mark.parametrize(
    ("changes", "lost"),
    [
        ({}, False),
        ({"error": 0.149}, False),
        ({"error": 0.151}, True),
        ({"error": math.nan}, True),
        ({"areas": 12}, False),
        ({"areas": 11}, True),
        ({"doors": None}, True),
        ({"edges": 0.7}, True),
        ({"fault": "LinAlgError: singular"}, True),
    ],
)
def test_when_a_map_is_lost(scripts, changes, lost):
    sensitivity = scripts[1]
    default = sensitivity.Outcome(0.05, 16, 16, 1.0)
    assert sensitivity.is_lost(default._replace(**changes), default) is lost
    assert sensitivity.cell(default._replace(**changes), default).startswith("**") is lost


def test_a_run_is_judged_by_relations_or_by_the_trajectory(scripts):
    outcome = scripts[1].outcome
    run = {
        "ate_rmse": {"final": 0.2},
        "areas_matched": {"matched": 3},
        "doors_matched": {"matched": 2},
        "map": {"topology_precision": 1.0, "topology_recall": 0.5},
    }
    assert outcome(run) == (0.2, 3, 2, 0.5, None)
    assert outcome({**run, "relations": {"final": {"trans_mean": 0.04}}}).error == 0.04
    assert outcome({"ate_rmse": {"final": None}}).error == math.inf
    assert outcome({"fault": "it fell"}).fault == "it fell"


def test_the_page_of_thresholds_says_what_is_missing_and_what_is_lost(scripts):
    sensitivity = scripts[1]
    threshold = by_name(sensitivity)["loops.gate"]
    default = sensitivity.Outcome(0.04, 14, 15)
    rows = {
        (threshold, 0.8, "fr079"): default._replace(error=0.5),
        (threshold, 1.2, "fr079"): default,
        (threshold, 0.8, "aces"): None,
        (by_name(sensitivity)["loops.agree"], 0.8, "fr079"): None,
    }
    text = sensitivity.page({"fr079": default, "aces": default}, rows, 4, "commit abc")
    assert "**Partial**: 2 of 4 runs" in text
    assert "agree" not in text
    assert "| fr079 | mean of all relations | 40.0, 14 areas, 15 doors |" in text
    assert "| 1 of 2 |" in text
    assert "| `gate` | 11.3 | **lost** 500.0 14 15 | = |  | - |" in text
    assert "Partial" not in sensitivity.page({"fr079": default}, rows, 2, "commit abc")


def test_only_what_comes_after_the_filter_shares_its_run(scripts):
    shares = scripts[0].shares_the_filter
    assert shares(Config())
    assert shares(Config.model_validate({"loops": {"gate": 9.0}, "refine": {"steps": 2}}))
    assert not shares(Config.model_validate({"refine": {"enabled": False}}))
    assert not shares(Config.model_validate({"areas": {"min_area": 4.0}}))


def test_runs_are_made_once_and_kept(scripts, tmp_path):
    variants = scripts[0]
    config = Config.model_validate({"loops": {"enabled": False}})
    asked = [variants.Variant("no such world", one) for one in (Config(), config)]
    (tmp_path / "kept").mkdir()
    kept = variants.place(asked[0], tmp_path / "kept")
    kept.write_text(json.dumps({"ate_rmse": {"final": 1.0}}))
    told = []

    def tell(number, variant, figures):
        told.append((number, variant, figures))

    figures = variants.make_all(asked, tell, 1, tmp_path / "kept")
    assert figures[0] == {"ate_rmse": {"final": 1.0}}
    assert "no such world" in figures[1]["fault"]
    assert [number for number, *_ in told] == [1, 2]
    assert variants.kept_figures(asked[1], tmp_path / "kept") == figures[1]
    assert not list((tmp_path / "kept").glob("*.part"))


def test_logs_that_are_not_here_are_told_and_skipped(scripts, capsys, monkeypatch, tmp_path):
    variants = scripts[0]
    monkeypatch.setattr(variants, "DATA", tmp_path)
    assert variants.present(["fr079", "office"]) == ["office"]
    assert capsys.readouterr().err == "fr079: skipped, its log is not in ../shared/data\n"


def test_every_part_can_be_left_out(scripts):
    ablation = scripts[2]
    configs = [part.config() for part in ablation.PARTS]
    assert configs[0] == Config()
    assert all(config != Config() for config in configs[1:])
    assert len({part.name for part in ablation.PARTS}) == len(configs) > 8


def test_a_row_of_the_ablation(scripts):
    ablation = scripts[2]
    ring = {
        "ate_rmse": {"filter": 0.010, "final": 0.002},
        "nees_robot_filter": 1.5,
        "nees_robot": 1.0,
        "areas": 3,
        "doors": 3,
        "areas_matched": {"matched": 3},
        "doors_matched": {"matched": 3},
        "visited": {"areas": 3, "doors": 3},
    }
    worse = {**ring, "ate_rmse": {"filter": 0.03, "final": 0.004}, "areas": 4}
    real = {
        "relations": {"filter": {"trans_mean": 0.05}, "final": {"trans_mean": 0.04}},
        "areas_matched": {"matched": 14},
        "doors_matched": {"matched": 15},
    }
    aces = {"ate_rmse": {"filter": 0.5, "final": 0.09}}
    runs = {"fr079": [real], "aces": [aces], "ring": [ring, worse]}
    text = ablation.row(ablation.PARTS[0], runs)
    assert text == (
        "| nothing: the defaults | 0.050 / 0.040 | 14, 15 | 0.500 / 0.090"
        " | 20.0 / 3.0 | 30.0 / 4.0 | 1.50 / 1.00 | right in 1 of 2 |"
    )
    broken = ablation.row(ablation.PARTS[1], {**runs, "fr079": [{"fault": "it fell"}]})
    assert broken.startswith("| landmarks only | failed 1 of 1 |  | 0.500 / 0.090 |")
    page = ablation.page([text, broken], list(runs), 2, "commit abc")
    widths = {line.count("|") for line in page.splitlines() if line.startswith("|")}
    assert widths == {9}
