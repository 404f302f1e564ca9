"""A small building on the disk: its reference, its truth, a run of it, and a map of cells."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pydantic_core
from large_building import boxes, model_of, path_through, reference_of
from PIL import Image

from hiermap_cli.documents.reference import reference_document
from hiermap_cli.documents.results import write_result
from hiermap_cli.documents.trajectories import write_tum
from hiermap_cli.mapping.model import HierarchicalModel, MapResult, Trajectory

if TYPE_CHECKING:
    from pathlib import Path

AREAS = boxes(1, 4)  # eight rooms of different widths and a corridor
REFERENCE = reference_of(AREAS)
TRACK = path_through(AREAS)
MODEL = model_of(AREAS, REFERENCE)


def write_run(folder: Path, model: HierarchicalModel = MODEL, track: Trajectory = TRACK) -> Path:
    folder.mkdir(parents=True)
    write_result(folder, MapResult(model, track, track, (), (), {}, {}))
    return folder


def write_truth(folder: Path, poses=TRACK.poses, stamps_ns=TRACK.stamps_ns) -> Path:
    path = folder / "truth.tum"
    with path.open("w") as file:
        write_tum(file, stamps_ns, poses)
    return path


def write_reference(folder: Path, reference=REFERENCE, name: str = "reference.json") -> Path:
    path = folder / name
    path.write_bytes(pydantic_core.to_json(reference_document(reference)))
    return path


def write_map(folder: Path, resolution: float = 0.05, origin=(-1.0, -1.0, 0.0)) -> Path:
    """The building as map.yaml and map.png, and its rooms as rooms.png with doors left open."""
    polygons = [polygon for _, polygon in AREAS.values()]
    high = np.max(np.concatenate(polygons), axis=0) + 1.0
    width, height = np.ceil((high - origin[:2]) / resolution).astype(int)
    grey = np.full((height, width), 205, dtype=np.uint8)
    rooms = np.zeros((height, width, 3), dtype=np.uint8)

    def cells(low, top):
        first = np.round((low - origin[:2]) / resolution).astype(int)
        last = np.round((top - origin[:2]) / resolution).astype(int)
        return np.s_[first[1] : last[1], first[0] : last[0]]

    for polygon in polygons:
        grey[cells(polygon[0] - 0.2, polygon[2] + 0.2)] = 0
    for i, polygon in enumerate(polygons):
        grey[cells(polygon[0], polygon[2])] = 254
        rooms[cells(polygon[0], polygon[2])] = (20 + 20 * i, 255 - 20 * i, 128)
    for door in REFERENCE.doors:
        grey[cells(door.p1 - np.array([0.0, 0.1]), door.p2 + np.array([0.0, 0.1]))] = 254
    Image.fromarray(grey[::-1]).save(folder / "map.png")
    Image.fromarray(grey[::-1]).save(folder / "map.pgm")
    Image.fromarray(rooms[::-1]).save(folder / "rooms.png")
    (folder / "map.yaml").write_text(
        f"image: map.png\nresolution: {resolution}\norigin: {list(origin)}\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    return folder / "map.yaml"
