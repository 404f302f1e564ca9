"""Small worlds for the tests of the simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hiermap_cli.simulation.spec import WorldSpec
from hiermap_cli.simulation.world import World, build_world

ROOT = Path(__file__).resolve().parents[1]
DATASETS = ROOT / "datasets"
SMALL_WORLDS = ("ring", "room_corridor", "room")  # those with a log in datasets/

ONE_ROOM: dict[str, Any] = {
    "wall_thickness": 0.2,
    "areas": [{"id": "A", "box": [0.0, 0.0, 6.0, 4.0]}],
    "way_points": [[1.0, 1.0], [5.0, 1.0], [5.0, 3.0]],
}
TWO_ROOMS: dict[str, Any] = {
    "wall_thickness": 0.2,
    "areas": [
        {"id": "A", "box": [0.0, 0.0, 6.0, 4.0]},
        {"id": "B", "kind": "corridor", "box": [6.0, 0.0, 10.0, 4.0]},
    ],
    "doors": [{"id": "D", "areas": ["A", "B"], "at": [6.0, 2.0], "width": 1.0}],
    "way_points": [[1.0, 2.0], [9.0, 2.0]],
}


def spec_of(base: dict[str, Any], **changes: Any) -> WorldSpec:
    return WorldSpec.model_validate({**base, **changes})


def world_of(base: dict[str, Any], **changes: Any) -> World:
    return build_world(spec_of(base, **changes))
