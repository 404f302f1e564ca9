"""Maps of map_server, and a model against one: figures by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from PIL import Image

from hiermap_cli.documents.occupancy import read_map_server
from hiermap_cli.errors import InputError
from hiermap_cli.evaluation.occupied import occupancy_metrics
from hiermap_cli.evaluation.placed import PlacedArea, PlacedModel, PlacedPoints
from hiermap_cli.evaluation.tracing import traced_walls

HEAD = "image: {image}\nresolution: 0.5\norigin: [1.0, 2.0, {turn}]\n"


def written(folder, pixels, more="", image="m.pgm", turn=0.0):
    Image.fromarray(np.array(pixels, dtype=np.uint8)).save(folder / image)
    (folder / "m.yaml").write_text(HEAD.format(image=image, turn=turn) + more)
    return folder / "m.yaml"


def test_cells_lie_where_the_origin_says(tmp_path):
    grid = read_map_server(written(tmp_path, [[0, 254, 205], [254, 254, 0]]))
    assert grid.centres(grid.occupied).tolist() == [[2.25, 2.25], [1.25, 2.75]]
    assert grid.free.sum() == 3
    assert not grid.free[1, 2]  # unknown, though its share is below free_thresh


def test_a_turned_map(tmp_path):
    grid = read_map_server(written(tmp_path, [[254, 254], [254, 0]], turn=math.pi / 2))
    assert grid.centres(grid.occupied)[0] == pytest.approx([0.75, 2.75])
    at, exists = grid.cells(np.array([[0.75, 2.75], [5.0, 5.0]]))
    assert at[0].tolist() == [0, 1]
    assert exists.tolist() == [True, False]


@pytest.mark.parametrize(
    ("more", "occupied", "free"),
    [
        ("negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n", 1, 1),
        ("negate: 1\noccupied_thresh: 0.65\nfree_thresh: 0.2\n", 1, 1),
        ("negate: 0\noccupied_thresh: 0.4\nfree_thresh: 0.2\n", 2, 1),
        ("negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.6\n", 1, 2),
        ("mode: raw\noccupied_thresh: 0.4\nfree_thresh: 0.2\n", 0, 1),
    ],
)
def test_thresholds(tmp_path, more, occupied, free):
    path = written(tmp_path, [[0, 128, 255]], more)
    if not occupied:
        with pytest.raises(InputError, match="no occupied cell"):
            read_map_server(path)
        return
    grid = read_map_server(path)
    assert (grid.occupied.sum(), grid.free.sum()) == (occupied, free)


def test_kinds_of_images(tmp_path):
    grey = np.array([[0, 254, 100], [254, 254, 0]], dtype=np.uint8)
    wanted = read_map_server(written(tmp_path, grey))
    for name, image in (
        ("a.png", Image.fromarray(grey)),
        ("b.png", Image.fromarray(grey).convert("RGB")),
        ("c.png", Image.fromarray(grey).convert("RGBA")),
        ("d.png", Image.fromarray(grey).convert("P")),
        ("e.png", Image.fromarray(grey.astype(np.uint16) * 257)),
    ):
        image.save(tmp_path / name)
        (tmp_path / "m.yaml").write_text(HEAD.format(image=name, turn=0.0))
        grid = read_map_server(tmp_path / "m.yaml")
        assert np.array_equal(grid.occupied, wanted.occupied), name
        assert np.array_equal(grid.free, wanted.free), name


def test_thresholds_that_overlap_are_refused(tmp_path):
    path = written(tmp_path, [[0, 255]], "occupied_thresh: 0.3\nfree_thresh: 0.5\n")
    with pytest.raises(InputError, match="is not below"):
        read_map_server(path)


def model(segments, polygon):
    none = PlacedPoints((), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0))
    return PlacedModel(
        none, np.array(segments), (), (PlacedArea("A1", np.array(polygon)),), ("L1",)
    )


def test_agreement_by_hand(tmp_path):
    """A wall of cells at x from 2.0 to 2.5 over the whole height; free ground left of it."""
    grid = read_map_server(written(tmp_path, [[254, 254, 0, 205]] * 8))
    # Along y = 3: from 1.0 to 2.0 free, of which the last 0.2 m are near; 2.0 to 2.5 in the wall;
    # to 3.0 unknown, of which 0.2 m are near: 0.9 m of 2.0 m.
    walls = [[[1.0, 3.0], [3.0, 3.0]]]
    ground = [[1.0, 2.0], [3.0, 2.0], [3.0, 4.0], [1.0, 4.0]]
    found = occupancy_metrics(model(walls, ground), grid)
    assert found.walls == pytest.approx(0.9 / 2.0, abs=0.03)
    assert found.free == pytest.approx(0.5, abs=0.03)
    assert found.by_area == (("A1", pytest.approx(0.5, abs=0.03)),)


@pytest.mark.parametrize("thick", [1, 2, 6])
def test_walls_are_traced_where_they_face_free_ground(tmp_path, thick):
    """A room of 20 x 15 m with walls of one cell and more, unknown outside: its four sides."""
    pixels = np.full((50, 60), 205)
    pixels[10 - thick : 40 + thick, 10 - thick : 50 + thick] = 0
    pixels[10:40, 10:50] = 254
    walls = traced_walls(read_map_server(written(tmp_path, pixels)))
    assert len(walls) == 4
    ends = {tuple(end) for wall in walls.reshape(-1, 2, 2).tolist() for end in wall}
    assert ends == {(6.0, 7.0), (26.0, 7.0), (26.0, 22.0), (6.0, 22.0)}
