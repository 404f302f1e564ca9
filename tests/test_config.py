"""The configuration: strict YAML, all faults at once, defaults that read back."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field

from hiermap_cli.config import Config, Section
from hiermap_cli.configfile import load_config, parse_yaml, read_yaml, top_keys
from hiermap_cli.configtext import config_text
from hiermap_cli.errors import EXIT_USAGE, ConfigurationError

ROOT = Path(__file__).resolve().parents[1]


class Inner(Section):
    number: float = Field(0.5, gt=0, le=2)
    count: int = 3
    flag: bool = False
    text: str = "a b"
    maybe: str | None = None


class Outer(Section):
    inner: Inner = Inner()
    other: Inner | None = None
    choice: Literal["one", "two"] = "one"
    numbers: tuple[float, ...] = (1.0, 2.5e-7)
    pair: tuple[int, float] = (1, 2.0)
    items: list[Inner] = Field(default_factory=list)
    table: dict[str, float] = Field(default_factory=dict)


def parse(text: str) -> Outer:
    return parse_yaml(text, "f.yaml", Outer)


def faults(text: str, shape: type[Section] = Outer) -> list[str]:
    with pytest.raises(ConfigurationError) as caught:
        parse_yaml(text, "f.yaml", shape)
    assert caught.value.exit_status == EXIT_USAGE
    return caught.value.faults


# --- what a scalar is ---


@pytest.mark.parametrize(
    ("text", "value"),
    [("1e-3", 1e-3), ("1E+2", 100.0), (".5", 0.5), ("+2", 2.0), ("1.", 1.0), ("007e-1", 0.7)],
)
def test_numbers_of_every_spelling_are_numbers(text, value):
    assert parse_yaml(f"numbers: [{text}]", "f", Outer).numbers == (value,)


@pytest.mark.parametrize(
    "text", ["1:30", "1_000", "0x10", '"0.5"', "true", "yes", "1e", "--1", "abc"]
)
def test_what_is_no_number_is_a_fault(text):
    (fault,) = faults(f"inner: {{number: {text}}}")
    assert fault.startswith("line 1: inner.number: ")


@pytest.mark.parametrize("text", ["yes", "on", "true", "Yes", "TRUE"])
def test_words_of_truth_for_a_key_of_booleans(text):
    assert parse(f"inner: {{flag: {text}}}").inner.flag is True


@pytest.mark.parametrize("text", ["no", "off", "false", "No"])
def test_words_of_falsehood_for_a_key_of_booleans(text):
    assert parse(f"inner: {{flag: {text}}}").inner.flag is False


@pytest.mark.parametrize(
    "text", ["no", "yes", "on", "off", "true", "123", "1e-3", "1:30", "2026-01-01"]
)
def test_a_key_of_text_keeps_the_text(text):
    read = parse(f"inner: {{text: {text}, maybe: {text}}}").inner
    assert (read.text, read.maybe) == (text, text)


@pytest.mark.parametrize("text", ["null", "~", ""])
def test_null_where_it_is_allowed(text):
    assert parse(f"inner: {{maybe: {text}}}").inner.maybe is None
    assert parse(f"other: {text}").other is None


def test_quoted_null_is_text():
    assert parse("inner: {maybe: 'null'}").inner.maybe == "null"


@pytest.mark.parametrize("text", ["1", "'yes'", "maybe", "2"])
def test_what_is_no_boolean_is_a_fault(text):
    assert "inner.flag" in faults(f"inner: {{flag: {text}}}")[0]


def test_an_integer_is_not_cut():
    assert "inner.count" in faults("inner: {count: 2.5}")[0]


@pytest.mark.parametrize("text", [".inf", "-.inf", ".nan", ".NaN", "1e999"])
def test_no_infinity(text):
    assert "inner.number" in faults(f"inner: {{number: {text}}}")[0]


def test_lists_tuples_and_tables():
    read = parse("numbers: [1, 1e-3]\npair: [3, 4]\nitems: [{count: 4}, {}]\ntable: {a: 1, b: 2e0}")
    assert read.numbers == (1.0, 1e-3)
    assert read.pair == (3, 4.0)
    assert [item.count for item in read.items] == [4, 3]
    assert read.table == {"a": 1.0, "b": 2.0}


# --- faults ---


def test_five_faults_are_listed_with_path_and_line():
    text = """\
inner:
  number: 5
  nmuber: 1
choice: three
numbers:
  - 1
  - x
items:
  - {count: 1.5}
"""
    found = faults(text)
    assert [fault.split(": ")[:2] for fault in found] == [
        ["line 2", "inner.number"],
        ["line 3", "inner.nmuber"],
        ["line 4", "choice"],
        ["line 7", "numbers[1]"],
        ["line 9", "items[0].count"],
    ]
    assert "did you mean number?" in found[1]


def test_hints_are_keys_of_the_same_place():
    assert faults("items: [{}, {cuont: 1}]") == [
        "line 1: items[1].cuont: unknown key; did you mean count?"
    ]
    assert faults("numbr: 1") == ["line 1: numbr: unknown key; did you mean numbers?"]
    assert faults("flag: 1") == ["line 1: flag: unknown key"]  # a key, but not of this place


def test_another_document_has_one_fault_and_not_one_for_every_key(tmp_path):
    path = tmp_path / "world.yaml"
    path.write_text("# a floor plan\nformat: hiermap-world\nversion: [1, 0]\nway_points: []\n")
    with pytest.raises(ConfigurationError) as caught:
        load_config(path)
    assert caught.value.faults == [
        "line 2: is a hiermap-world document; another kind of file is expected"
    ]


def test_the_lasers_reach_is_a_length(tmp_path):
    path = tmp_path / "config.yaml"
    path.write_text("laser: {range_min: -1, range_max: 0}\n")
    with pytest.raises(ConfigurationError) as caught:
        load_config(path)
    assert [fault.split(": ")[1] for fault in caught.value.faults] == [
        "laser.range_max",
        "laser.range_min",
    ]


def test_repeated_keys_are_faults():
    found = faults("inner: {count: 1}\ninner:\n  count: 2\n  count: 3\n")
    assert found[0] == "line 2: inner: given twice (first in line 1)"


def test_repeated_keys_inside_and_other_faults_together():
    found = faults("inner:\n  count: 2\n  count: 3\nchoice: x\n")
    assert len(found) == 2
    assert "line 3: inner.count: given twice" in found[0]
    assert "line 4: choice" in found[1]


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("inner:\n\tcount: 1", "tab"),
        ("inner: {}\n---\nchoice: one", "second document"),
        ("- 1\n- 2", "key: value"),
        ("just text", "key: value"),
        ("inner: *nothing", "alias"),
        ("inner: {count: 1", "line 1"),
        ("a: \x01", "not allow"),
        ("? [a]\n: 1", "key must be a word"),
        ("[" * 3000, "deep"),
        ("inner: &x {maybe: *x}", "without end"),
        ("inner: [1, 2]", "inner"),
        ("inner: 5", "inner"),
        ("!!python/object/apply:os.system [ls]", "key: value"),
    ],
)
def test_traps_of_yaml_are_faults(text, word):
    assert word in " ".join(faults(text))


def test_a_bomb_of_anchors_ends_early():
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9)]
    assert "without end" in faults("\n".join(lines))[0]


def test_honest_anchors_are_allowed():
    read = parse("inner: &i {count: 7}\nother: *i")
    assert read.other is not None
    assert read.other.count == 7


@pytest.mark.parametrize("text", ["", "# nothing\n", "{}", "inner:\n", "\ufeff"])
def test_an_empty_file_is_the_defaults(tmp_path, text):
    path = tmp_path / "f.yaml"
    path.write_text(text)
    assert read_yaml(path, Outer) == Outer()


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"inner: \xe4", b"\x89MCAP0\r\n\x01"])
def test_what_is_no_utf8_is_a_fault(tmp_path, content):
    path = tmp_path / "f.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError, match="UTF-8"):
        read_yaml(path, Outer)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(ConfigurationError, match="No such file"):
        load_config(tmp_path / "none.yaml")
    with pytest.raises(ConfigurationError, match="directory"):
        load_config(tmp_path)
    big = tmp_path / "big.yaml"
    big.write_text("#" * 1_100_000)
    with pytest.raises(ConfigurationError, match="larger"):
        load_config(big)


@given(st.text(alphabet=st.characters(exclude_categories=["Cs"]), max_size=60))
@settings(max_examples=200, deadline=None)
def test_any_text_is_read_or_refused(text):
    try:
        parse(text)
    except ConfigurationError as error:
        assert error.faults


@given(st.text(alphabet="abcino: -[]{}&*!|>#\n\t'\"0123.e~", max_size=40))
@settings(max_examples=300, deadline=None)
def test_any_near_yaml_is_read_or_refused(text):
    try:
        parse("inner: " + text)
    except ConfigurationError as error:
        assert error.faults


# --- printing ---


def test_defaults_read_back():
    assert parse_yaml(config_text(Config()), "printed", Config) == Config()


def test_defaults_read_back_by_another_reader():
    assert yaml.safe_load(config_text(Config()))["laser"]["sigma_range"] == 0.01
    shown = yaml.safe_load(config_text(Outer()))
    assert shown["numbers"] == [1.0, 2.5e-7]  # an exponent that YAML 1.1 reads as well


@given(
    st.builds(
        Inner,
        number=st.floats(1e-300, 2),
        count=st.integers(-(10**20), 10**20),
        flag=st.booleans(),
        text=st.text(alphabet=st.characters(exclude_categories=["Cs", "Cc"]), max_size=20),
        maybe=st.none() | st.sampled_from(["no", "null", "~", "", "1e3", "#", "a: b", " x ", "\t"]),
    ),
    st.sampled_from(["one", "two"]),
    st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=4),
)
@settings(max_examples=150, deadline=None)
def test_any_values_read_back(inner, choice, numbers):
    values = Outer(inner=inner, other=inner, choice=choice, numbers=tuple(numbers))
    assert parse(config_text(values)) == values


def test_every_key_is_explained():
    lines = config_text(Config()).splitlines()
    keys = [i for i, line in enumerate(lines) if line.strip() and not line.strip().startswith("#")]
    assert keys
    for index in keys:
        assert lines[index - 1].strip().startswith("# "), lines[index]


def test_every_field_has_a_description():
    for name, field in Config.model_fields.items():
        section = field.annotation
        if isinstance(section, type) and issubclass(section, Section):
            for key, inner in section.model_fields.items():
                assert inner.description, f"{name}.{key} has no description"
        else:
            assert field.description, f"{name} has no description"


@pytest.mark.parametrize("path", sorted((ROOT / "configs").glob("*.yaml")), ids=lambda p: p.name)
def test_shipped_configurations_hold(path):
    assert isinstance(load_config(path), Config)


def test_top_keys(tmp_path):
    path = tmp_path / "f.yaml"
    path.write_text("a: 1\nb: {c: 2}\nd: []\n? [x]\n: y\n")
    assert {"a": str, "b": dict, "d": list}.items() <= top_keys(path).items()
    path.write_text("- 1\n")
    assert top_keys(path) == {}
