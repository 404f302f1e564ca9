"""Office floors of any size, for benchmarks and for studies over many seeds.

A floor is a chain of blocks in the plane. Each block is a ring corridor of four arms, parted by
fire doors, about a core of six rooms: ten areas and one loop. The chain itself closes no loop, so
20 blocks are 200 areas and 20 loops. The robot goes round every ring, visits every room, closes
the ring and goes on to the next block.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hiermap_cli.simulation.polygons import way_clearance
from hiermap_cli.simulation.spec import WorldSpec
from hiermap_cli.simulation.world import World, build_world

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

AREAS_PER_BLOCK = 10
WIDTH, HEIGHT = 20.0, 15.0  # metres of a block, between the middle lines of its outer walls
CORRIDOR = 2.2  # metres between the middle lines of a corridor's walls
_LANE = 0.5 * CORRIDOR
_HALF_WALL = 0.075
_FREE_WAY = 0.5  # metres that furniture keeps off the robot's way
_TRIES = 40  # places thought of for a piece of furniture


class _Station(NamedTuple):
    """A room as the ring sees it: where its door is along the ring, and the way into it."""

    along: float
    door: tuple[float, float]  # the point in the corridor before the door
    inside: tuple[float, float]  # the point in the room behind it
    goal: tuple[float, float]


def office_floor(blocks: int, rng: np.random.Generator, **settings: Any) -> World:
    """A floor of 10 areas and one loop a block; rooms, doors and furniture differ by chance.

    Args:
        blocks: at least 1.
        rng: the only source of chance.
        settings: sections of the world file to set, as `laser={"rate": 10.0}`.
    """
    columns = math.ceil(math.sqrt(blocks))
    spec: dict[str, Any] = {
        "name": f"office floor of {blocks} blocks",
        "areas": [],
        "doors": [],
        "furniture": [],
        "walls": [],
        "way_points": [],
    }
    entry = 0.0
    for index in range(blocks):
        row, column = divmod(index, columns)
        if row % 2:
            column = columns - 1 - column
        corner = np.array([column * WIDTH, row * HEIGHT])
        leaves_row = index % columns == columns - 1
        exit_at = None if index + 1 == blocks else _gate("N" if leaves_row else "WE"[row % 2 == 0])
        _block(spec, index, corner, (entry, exit_at), rng)
        if exit_at is not None:
            side = "N" if leaves_row else "WE"[row % 2 == 0]
            _connect(spec, index, side, corner)
            entry = _gate({"N": "S", "E": "W", "W": "E"}[side])
    spec |= settings
    return build_world(WorldSpec.model_validate(spec), spec["name"])


# --- the ring: a closed lane along the middle of the four arms, counterclockwise from the
# --- south-western corner


_RING_W, _RING_H = WIDTH - CORRIDOR, HEIGHT - CORRIDOR
_RING = 2.0 * (_RING_W + _RING_H)


def _on_ring(along: float) -> tuple[float, float]:
    """The point of the lane at a distance from the south-western corner, in the block."""
    s = along % _RING
    if s < _RING_W:
        return (_LANE + s, _LANE)
    if s < _RING_W + _RING_H:
        return (WIDTH - _LANE, _LANE + s - _RING_W)
    if s < 2.0 * _RING_W + _RING_H:
        return (WIDTH - _LANE - (s - _RING_W - _RING_H), HEIGHT - _LANE)
    return (_LANE, HEIGHT - _LANE - (s - 2.0 * _RING_W - _RING_H))


def _gate(side: str) -> float:
    """Where along the ring the door to the next block is: in the middle of a side."""
    return {
        "S": 0.5 * _RING_W,
        "E": _RING_W + 0.5 * _RING_H,
        "N": 1.5 * _RING_W + _RING_H,
        "W": 2.0 * _RING_W + 1.5 * _RING_H,
    }[side]


def _connect(spec: dict[str, Any], index: int, side: str, corner: Array) -> None:
    """The door from a block to the next one in the chain."""
    at = {"E": (WIDTH, HEIGHT / 2), "W": (0.0, HEIGHT / 2), "N": (WIDTH / 2, HEIGHT)}[side]
    arms = [f"B{index}{side}", f"B{index + 1}{ {'E': 'W', 'W': 'E', 'N': 'S'}[side] }"]
    door = {"id": f"G{index}", "areas": arms, "at": _add(corner, at), "width": 1.0}
    spec["doors"].append(door)


def _block(
    spec: dict[str, Any],
    index: int,
    corner: Array,
    gates: tuple[float, float | None],
    rng: np.random.Generator,
) -> None:
    """Areas, doors, furniture and way points of one block, entered and left at `gates`."""
    name = f"B{index}"
    far_x, far_y = WIDTH - CORRIDOR, HEIGHT - CORRIDOR
    for side, box in (
        ("S", (0.0, 0.0, WIDTH, CORRIDOR)),
        ("N", (0.0, far_y, WIDTH, HEIGHT)),
        ("W", (0.0, CORRIDOR, CORRIDOR, far_y)),
        ("E", (far_x, CORRIDOR, WIDTH, far_y)),
    ):
        area = {"id": name + side, "kind": "corridor", "box": _add_box(corner, box)}
        spec["areas"].append(area)
    for pair, at in (
        ("SW", (_LANE, CORRIDOR)),
        ("SE", (WIDTH - _LANE, CORRIDOR)),
        ("NW", (_LANE, far_y)),
        ("NE", (WIDTH - _LANE, far_y)),
    ):
        arms = [name + pair[0], name + pair[1]]
        door = {"id": f"F{index}{pair}", "areas": arms, "at": _add(corner, at), "width": 1.4}
        spec["doors"].append(door)
    stations = _rooms(spec, index, corner, rng)
    _pilasters(spec, corner, rng)
    spec["way_points"] += [_add(corner, p) for p in _route(stations, gates)]


def _rooms(
    spec: dict[str, Any], index: int, corner: Array, rng: np.random.Generator
) -> list[_Station]:
    """The six rooms of the core: three columns, each parted at a height of its own."""
    stations = []
    third = (WIDTH - 2.0 * CORRIDOR) / 3.0
    inner = CORRIDOR + third * np.array([1.0, 2.0]) + rng.uniform(-0.7, 0.7, 2)
    xs = [CORRIDOR, *inner.tolist(), WIDTH - CORRIDOR]
    for column in range(3):
        x1, x2 = xs[column], xs[column + 1]
        middle = 0.5 * HEIGHT + float(rng.uniform(-0.6, 0.6))
        for side, y1, y2 in (("S", CORRIDOR, middle), ("N", middle, HEIGHT - CORRIDOR)):
            room = f"B{index}R{side}{column}"
            box = (x1, y1, x2, y2)
            spec["areas"].append({"id": room, "box": _add_box(corner, box)})
            x = float(rng.uniform(x1 + 0.8, x2 - 0.8))
            wall, inwards = (y1, 1.0) if side == "S" else (y2, -1.0)
            arm = f"B{index}{side}"
            at = _add(corner, (x, wall))
            spec["doors"].append({"id": f"D{room}", "areas": [arm, room], "at": at})
            lane = wall - inwards * _LANE
            goal_x = float(np.clip(x + rng.uniform(-1.0, 1.0), x1 + 1.0, x2 - 1.0))
            goal = (goal_x, wall + inwards * float(rng.uniform(2.2, 3.0)))
            inside = (x, wall + inwards * 1.1)
            along = x - _LANE if side == "S" else _RING_W + _RING_H + (WIDTH - _LANE - x)
            stations.append(_Station(along, (x, lane), inside, goal))
            way = np.array([[x, lane, *inside], [*inside, *goal]])
            spec["furniture"] += [
                {"box": _add_box(corner, piece)} for piece in _furniture(box, way, rng)
            ]
    return stations


def _furniture(
    box: tuple[float, float, float, float], way: Array, rng: np.random.Generator
) -> list[tuple[float, float, float, float]]:
    """Up to three boxes along the walls of a room, off the robot's way and off each other."""
    x1, y1, x2, y2 = (
        box[0] + _HALF_WALL,
        box[1] + _HALF_WALL,
        box[2] - _HALF_WALL,
        box[3] - _HALF_WALL,
    )
    pieces: list[tuple[float, float, float, float]] = []
    wanted = int(rng.integers(2, 4))
    for _ in range(_TRIES):
        if len(pieces) == wanted:
            break
        long, deep = (float(v) for v in rng.uniform([0.8, 0.4], [1.8, 0.8]))
        wall = int(rng.integers(4))
        w, h = (long, deep) if wall % 2 == 0 else (deep, long)
        x = {1: x2 - w, 3: x1}.get(wall, x1 + (x2 - x1 - w) * float(rng.random()))
        y = {0: y1, 2: y2 - h}.get(wall, y1 + (y2 - y1 - h) * float(rng.random()))
        piece = (x, y, x + w, y + h)
        outline = np.array(
            [
                [x, y, x + w, y],
                [x + w, y, x + w, y + h],
                [x + w, y + h, x, y + h],
                [x, y + h, x, y],
            ]
        )
        apart = all(
            piece[0] > p[2] + 0.2
            or piece[2] < p[0] - 0.2
            or piece[1] > p[3] + 0.2
            or piece[3] < p[1] - 0.2
            for p in pieces
        )
        if apart and way_clearance(way, outline).min() > _FREE_WAY:
            pieces.append(piece)
    return pieces


def _pilasters(spec: dict[str, Any], corner: Array, rng: np.random.Generator) -> None:
    """Two shallow pilasters on the outer wall of either long arm, off the doors between blocks."""
    for y in (0.0, HEIGHT - 0.3):
        for low, high in ((1.5, 7.5), (11.5, 17.5)):
            x, width = float(rng.uniform(low, high)), float(rng.uniform(0.4, 0.9))
            spec["walls"].append({"box": _add_box(corner, (x, y, x + width, y + 0.3))})


def _route(
    stations: list[_Station], gates: tuple[float, float | None]
) -> list[tuple[float, float]]:
    """Way points in the block: once round from the entry, into every room, then to the exit."""
    entry, exit_at = gates
    corners = [0.0, _RING_W, _RING_W + _RING_H, 2.0 * _RING_W + _RING_H]
    last = entry + _RING + (0.0 if exit_at is None else (exit_at - entry) % _RING)
    stops: list[tuple[float, list[tuple[float, float]]]] = [(entry, [_on_ring(entry)])]
    for turn in (0.0, _RING, 2.0 * _RING):
        stops += [(c + turn, [_on_ring(c)]) for c in corners if entry < c + turn < last]
    for station in stations:
        along = entry + (station.along - entry) % _RING
        visit = [station.door, station.inside, station.goal, station.inside, station.door]
        stops.append((along, visit))
    stops.append((last, [_on_ring(last)]))
    return [point for _, points in sorted(stops, key=lambda stop: stop[0]) for point in points]


def _add(corner: Array, point: tuple[float, float]) -> tuple[float, float]:
    return (float(corner[0]) + point[0], float(corner[1]) + point[1])


def _add_box(
    corner: Array, box: tuple[float, float, float, float]
) -> tuple[float, float, float, float]:
    return (*_add(corner, box[:2]), *_add(corner, box[2:]))
