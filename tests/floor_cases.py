"""Office floors by chance: a corridor, rooms on both of its sides, a robot that visits all.

Nothing of the program was ever fitted to one of them: they stand for buildings not seen before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import yaml

from hiermap_cli.simulation.world import load_world

if TYPE_CHECKING:
    from pathlib import Path

    from hiermap_cli.simulation.world import World

WALL = 0.15  # metres thick
MARGIN = 1.2  # metres from a door at which the robot turns to it
DEGREE = float(np.pi / 180.0)

LASERS: dict[str, dict[str, Any]] = {
    "half circle of 10 m": {
        "beams": 181, "angle_min": -90.0 * DEGREE, "angle_increment": DEGREE,
        "range_max": 10.0, "rate": 5.0, "sigma": 0.02,
    },
    "three quarters of 12 m": {
        "beams": 271, "angle_min": -135.0 * DEGREE, "angle_increment": DEGREE,
        "range_max": 12.0, "rate": 4.0, "sigma": 0.01,
    },
    "three quarters of 30 m, fine": {
        "beams": 1081, "angle_min": -135.0 * DEGREE, "angle_increment": 0.25 * DEGREE,
        "range_max": 30.0, "rate": 5.0, "sigma": 0.01,
    },
    "full circle of 6 m": {
        "beams": 360, "angle_min": -180.0 * DEGREE, "angle_increment": DEGREE,
        "range_max": 6.0, "rate": 6.0, "sigma": 0.02,
    },
}  # fmt: skip


class Room(NamedTuple):
    """A room beside the corridor; side: 1 above it, -1 below; door: its x."""

    id: str
    side: int
    left: float
    width: float
    depth: float
    door: float


def random_floor(laser: str, rng: np.random.Generator, folder: Path) -> World:
    """A floor of the corridor C and rooms R1.., each with its door D1.. to the corridor."""
    length, across = _cm(rng.uniform(14.0, 26.0)), _cm(rng.uniform(1.7, 2.6))
    rooms: list[Room] = []
    for side in (-1, 1):
        rooms += _row(side, length, 1 + len(rooms), rng)
    areas = [{"id": "C", "kind": "corridor", "polygon": _box(0.0, 0.0, length, across)}]
    doors, furniture = [], []
    for room in rooms:
        wall = across if room.side > 0 else 0.0
        low = wall if room.side > 0 else wall - room.depth
        polygon = _box(room.left, low, room.left + room.width, low + room.depth)
        areas.append({"id": room.id, "kind": "room", "polygon": polygon})
        width = _cm(rng.uniform(0.8, 1.0))
        name = f"D{room.id[1:]}"
        doors.append({"id": name, "areas": ["C", room.id], "at": [room.door, wall], "width": width})
        furniture += [{"box": box} for box in _furniture(room, wall, rng)]
    tour = [[1.2, _cm(0.5 * across)]]
    for room in sorted(rooms, key=lambda room: room.door):
        tour += _visit(room, across, 0.5)
    tour.append([1.2, _cm(0.5 * across)])
    world = {
        "format": "hiermap-world", "version": [1, 0], "name": "random floor",
        "wall_thickness": WALL, "areas": areas, "doors": doors, "furniture": furniture,
        "way_points": tour, "robot": {"speed": 0.5, "turn_rate": 0.8},
        "laser": LASERS[laser], "odometry": {"rate": 12.0},
    }  # fmt: skip
    path = folder / "floor.yaml"
    path.write_text(yaml.safe_dump(world, sort_keys=False))
    return load_world(path)


def _row(side: int, length: float, number: int, rng: np.random.Generator) -> list[Room]:
    """Rooms along one side of the corridor, of one depth, that fill its length."""
    depth, left = _cm(rng.uniform(3.5, 5.5)), 0.0
    rooms: list[Room] = []
    while left < length:
        width = _cm(rng.uniform(3.2, 6.0))
        if length - left - width < 3.2:
            width = _cm(length - left)
        door = _cm(rng.uniform(left + 0.9, left + width - 0.9))
        rooms.append(Room(f"R{number + len(rooms)}", side, left, width, depth, door))
        left = _cm(left + width)
    return rooms


def _furniture(room: Room, wall: float, rng: np.random.Generator) -> list[list[float]]:
    """A cupboard at the far wall, at times with a gap behind it, and a desk away from the door."""
    boxes = []
    if rng.random() < 0.8:
        left = rng.uniform(room.left + 0.3, room.left + room.width - 1.8)
        near = room.depth - 0.5 * WALL - rng.choice([0.0, 0.0, 0.05, 0.15])
        y = sorted((wall + room.side * near, wall + room.side * (near - rng.uniform(0.4, 0.7))))
        boxes.append([_cm(left), y[0], _cm(left + rng.uniform(0.8, 1.4)), y[1]])
    if rng.random() < 0.6:
        deep = _cm(rng.uniform(0.5, 0.8))
        if room.door - room.left > 0.5 * room.width:
            left = room.left + 0.5 * WALL
        else:
            left = room.left + room.width - 0.5 * WALL - deep
        y = sorted((wall + room.side * 0.45 * room.depth, wall + room.side * 0.7 * room.depth))
        boxes.append([left, y[0], left + deep, y[1]])
    return [[round(float(value), 3) for value in box] for box in boxes]


def _visit(room: Room, across: float, share: float) -> list[list[float]]:
    """From the middle of the corridor into the room and back."""
    wall = across if room.side > 0 else 0.0
    corridor = [room.door, _cm(0.5 * across)]
    inside = [room.door, _cm(wall + room.side * MARGIN)]
    middle = room.left + 0.5 * room.width
    stop = [_cm(middle + 0.3 * (room.door - middle)), _cm(wall + room.side * share * room.depth)]
    return [corridor, inside, stop, inside, corridor]


def _box(x0: float, y0: float, x1: float, y1: float) -> list[list[float]]:
    return [[_cm(x), _cm(y)] for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]


def _cm(value: float) -> float:
    """To the centimetre, so that neighbours share their wall exactly."""
    return round(float(value), 2)
