"""map.svg: what is drawn, and where."""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from samples import sample_model, sample_trajectory

from hiermap_cli.documents import svg
from hiermap_cli.documents.checks import UnsoundValueError
from hiermap_cli.documents.svg import map_svg
from hiermap_cli.mapping.model import EnvironmentModel, Estimate, HierarchicalModel, Trajectory

NS = "{http://www.w3.org/2000/svg}"


def drawn(model=None, trajectory=None) -> ET.Element:
    model = sample_model() if model is None else model
    return ET.fromstring(map_svg(model, trajectory or sample_trajectory(50)))


def texts(root: ET.Element) -> list[str]:
    return [text.text for text in root.iter(f"{NS}text") if "halo" not in text.get("class")]


def moves(root: ET.Element, kind: str) -> int:
    """How many lines the first path of a kind has (the second is the legend's)."""
    path = next(p for p in root.iter(f"{NS}path") if p.get("class") == kind)
    return path.get("d").count("M")


def test_everything_is_there():
    root = drawn()
    assert {"A1 room", "A2 corridor", "D1", "trajectory"} <= set(texts(root))
    assert any(text.endswith(" m") for text in texts(root))
    assert len(list(root.iter(f"{NS}polygon"))) == 2
    assert moves(root, "wall") == 4  # two corners of two segments
    assert moves(root, "door") == 1
    assert len(list(root.iter(f"{NS}polyline"))) == 1


def test_everything_lies_on_the_picture():
    root = drawn()
    width, height = float(root.get("width")), float(root.get("height"))
    for shape in (*root.iter(f"{NS}polygon"), *root.iter(f"{NS}polyline")):
        for pair in shape.get("points").split():
            x, y = map(float, pair.split(","))
            assert 0 <= x <= width
            assert 0 <= y <= height


def test_legend_and_scale_bar_lie_on_a_narrow_picture():
    nothing = Estimate("g", np.zeros(3), np.zeros((3, 3)))
    model = HierarchicalModel(EnvironmentModel(nothing, (), np.zeros((3, 3)), ()), (), ())
    corridor = np.array([[0.0, -20.0, 1.57], [0.0, 20.0, 1.57]])
    root = drawn(model, replace(sample_trajectory(2), poses=corridor))
    last = next(t for t in root.iter(f"{NS}text") if t.text == "trajectory")
    assert float(last.get("x")) + 80 < float(root.get("width"))


def test_places_come_from_the_levels():
    model = sample_model()
    (first, one), *rest = model.environment.areas
    moved = Estimate("g", one.mean + np.array([0.0, 3.0, 0.0]), one.covariance)
    environment = replace(model.environment, areas=((first, moved), *rest))
    before = next(drawn(model).iter(f"{NS}polygon")).get("points")
    after = next(drawn(replace(model, environment=environment)).iter(f"{NS}polygon")).get("points")
    assert before != after


def test_the_scale_bar_has_the_length_it_says():
    root = drawn()
    canvas_scale = next(p for p in root.iter(f"{NS}path") if p.get("class") == "bar")
    start = float(canvas_scale.get("d").split()[0].removeprefix("M"))
    end = float(canvas_scale.get("d").split("H")[1].split("v")[0])
    metres = float(next(text for text in texts(root) if text.endswith(" m")).split()[0])
    polygon = next(root.iter(f"{NS}polygon")).get("points").split()
    corners = np.array([[float(v) for v in pair.split(",")] for pair in polygon])
    side = np.linalg.norm(corners[1] - corners[0])  # four metres in the sample
    assert (end - start) / metres == pytest.approx(side / 4.0, rel=0.01)


def test_names_are_text_and_no_markup():
    model = sample_model()
    door = replace(model.environment.doors[0], id="<D&1>")
    environment = replace(model.environment, doors=(door,))
    assert "<D&1>" in texts(drawn(replace(model, environment=environment)))


def test_a_label_lies_in_the_widest_part_of_an_area():
    """An L whose corner is the widest place of it, and a sliver that no point of the grid is in."""
    hook = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 1.0], [3.0, 3.0], [1.0, 8.0], [0.0, 8.0]])
    x, y = svg._inner_point(hook)
    assert 1.0 < x < 2.0
    assert 1.0 < y < 2.0
    sliver = np.array([[0.0, 0.0], [5.0, 10.0], [10.0, 0.0], [5.0, 9.999]])
    assert svg._inner_point(sliver) == pytest.approx(sliver.mean(axis=0))


def test_labels_never_lie_on_each_other():
    labels = svg._Labels()
    for name in ("A1", "A2", "A3"):
        labels.add(np.array([100.0, 100.0]), name, "area")
    boxes = sorted(labels._boxes, key=lambda box: box[3])
    for upper, lower in itertools.pairwise(boxes):
        assert upper[3] <= lower[2] + 1e-9


def test_neighbours_differ_in_colour():
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    extents = {f"A{i}{j}": square + np.array([i, j]) for i in range(8) for j in range(8)}
    fills = svg._fills(extents)
    for i in range(7):
        for j in range(8):
            assert fills[f"A{i}{j}"] != fills[f"A{i + 1}{j}"]
            assert fills[f"A{j}{i}"] != fills[f"A{j}{i + 1}"]


def test_an_empty_model_is_drawn():
    nothing = Estimate("g", np.zeros(3), np.zeros((3, 3)))
    model = HierarchicalModel(EnvironmentModel(nothing, (), np.zeros((3, 3)), ()), (), ())
    track = Trajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)))
    assert drawn(model, track).tag == f"{NS}svg"


def test_a_place_that_is_not_finite_is_a_fault():
    model = sample_model()
    area = replace(model.areas[0], extent=np.array([[0.0, 0], [np.nan, 0], [1, 1]]))
    with pytest.raises(UnsoundValueError):
        map_svg(replace(model, areas=(area, model.areas[1])), sample_trajectory(5))
