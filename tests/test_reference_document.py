from __future__ import annotations

import json

import numpy as np
import pytest
from map_cases import reference_map
from real_data import DATA

from hiermap_cli.documents.reference import read_reference, reference_document
from hiermap_cli.errors import InputError

EMPTY = {"format": "hiermap-reference", "version": [1, 0], "units": "m"}
AREA = {"id": "A1", "kind": "room", "polygon": [[0, 0], [4, 0], [4, 3]], "visited": True}
DOOR = {"id": "D0", "areas": ["A1", "A1"], "p1": [0, 0], "p2": [1, 0], "visited": True}


def read(tmp_path, document: object):
    path = tmp_path / "reference.json"
    path.write_text(document if isinstance(document, str) else json.dumps(document))
    return read_reference(path)


def test_what_was_written_is_read_again(tmp_path) -> None:
    written = reference_map()
    again = read(tmp_path, reference_document(written))
    assert again.walls is not None
    assert again.walls.tolist() == written.walls.tolist()
    assert again.furniture is not None
    assert again.furniture.shape == (0, 4)
    assert again.doors is not None
    assert [(d.id, d.areas, d.p1.tolist()) for d in again.doors] == [
        (d.id, d.areas, d.p1.tolist()) for d in written.doors
    ]
    assert reference_document(again) == reference_document(written)


def test_lists_that_are_missing_stay_missing(tmp_path) -> None:
    bare = read(tmp_path, EMPTY)
    assert (bare.walls, bare.furniture, bare.doors, bare.areas) == (None, None, None, None)
    assert reference_document(bare) == EMPTY


def test_keys_that_are_not_known_are_no_fault(tmp_path) -> None:
    again = read(tmp_path, EMPTY | {"name": "x", "areas": [AREA | {"colour": "red"}]})
    assert again.areas is not None
    assert again.areas[0].polygon == pytest.approx(np.array(AREA["polygon"]))


def test_all_faults_are_listed_in_one_line(tmp_path) -> None:
    document = {
        "format": "something",
        "version": [2, 0],
        "units": "cm",
        "walls": [[0, 0, 1, 0], [0, 0, 1], [0, 0, 0, 0], [0, 0, 1, float("nan")]],
        "furniture": 3,
        "areas": [
            AREA,
            AREA | {"visited": "yes"},
            {"id": "", "polygon": [[0, 0], [1, 1]]},
            AREA | {"id": "A2", "polygon": [[0, 0], [1, 1], [2, 2]]},
            AREA | {"kind": 7},
            "A9",
        ],
        "doors": [
            DOOR | {"areas": ["A1", "A7"]},
            DOOR,
            DOOR | {"p1": [0], "p2": None},
            DOOR | {"areas": ["A1"]},
        ],
    }
    with pytest.raises(InputError) as caught:
        read(tmp_path, document)
    message = str(caught.value)
    assert "\n" not in message
    for fault in (
        "format is 'something'",
        "version is [2, 0]",
        "units is 'cm'",
        "walls[1]: is not [x1, y1, x2, y2]",
        "walls[2]: begins where it ends",
        "walls[3]: is not [x1, y1, x2, y2]",
        "furniture: is no list",
        "areas[1].visited: is 'yes'",
        "areas[2].id",
        "areas[2].polygon: is not a list of three",
        "areas[3].polygon: has no area",
        "areas[4].kind: is 7",
        "areas[5]: is no object",
        "doors[2].p1: is not [x, y]",
        "doors[2].p2: is not [x, y]",
        "doors[3].areas: is ['A1']",
        "doors: id 'D0' is used more than once",
        "'D0' leads to area 'A7', which is not listed",
    ):
        assert fault in message, fault


@pytest.mark.parametrize(
    ("text", "said"),
    [("[1, 2", "is not JSON"), ("[]", "no object"), ("[" * 100_000, "is not JSON")],
)
def test_what_is_no_document(tmp_path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read(tmp_path, text)


def test_numbers_that_no_float_holds(tmp_path) -> None:
    text = json.dumps(EMPTY | {"walls": [[0, 0, 1, 777]]}).replace("777", "9" * 400)
    with pytest.raises(InputError, match=r"walls\[0\]"):
        read(tmp_path, text)


def test_a_file_that_cannot_be_read(tmp_path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_reference(tmp_path / "none.json")
    with pytest.raises(InputError, match="cannot be read"):
        read_reference(tmp_path)


def test_a_real_reference_map() -> None:
    path = DATA / "fr079" / "reference.json"
    if not path.exists():
        pytest.skip("the real logs are not there")
    reference = read_reference(path)
    assert reference.walls is None
    assert reference.areas is not None
    assert reference.doors is not None
    assert (len(reference.areas), len(reference.doors)) == (16, 16)
