"""Floors on which the robot comes back, with the filter's poses drifting by a known amount."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hiermap_cli.config import Config
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.keyscans import KeyScanRecord, KeyScans
from hiermap_cli.perception.segmentation import segment_block
from hiermap_cli.perception.views import scan_views
from hiermap_cli.simulation.simulator import simulate
from hiermap_cli.simulation.spec import WorldSpec
from hiermap_cli.simulation.world import World, build_world

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

KEY = 0.3  # metres between the key scans
KEY_ANGLE = 0.3


@dataclass(frozen=True)
class Drive:
    """Key scans, the true poses at them, and the poses of a filter that drifts; (K, 3) each."""

    keyscans: KeyScans
    truth: Array
    poses: Array

    def position_errors(self, poses: Array) -> Array:
        """Metres (K,) by which poses are off, seen from the first one."""
        right, said = (se2.between(p[:1], p) for p in (self.truth, poses))
        return np.hypot(*(right - said)[:, :2].T)

    def relation_error(self, i: int, j: int, R_i_j: Array) -> Array:
        """Of a loop: true less said."""
        off = se2.between(self.truth[i], self.truth[j]) - R_i_j
        off[2] = se2.wrap_one(float(off[2]))
        return off


def world_of(**spec: Any) -> World:
    spec.setdefault("laser", {})
    spec["laser"] = {"rate": 2.0, **spec["laser"]}
    return build_world(WorldSpec.model_validate({"wall_thickness": 0.15, **spec}))


def drive_of(
    world: World,
    seed: int = 0,
    *,
    scale: float = 0.0,
    curvature: float = 0.0,
    faults: dict[int, Array] | None = None,
) -> Drive:
    """What is left of a drive when the filter is through with it.

    The filter's poses drift by a scale and a curvature (rad/m); the odometry has these and its
    noise. `faults`: false motions added to the filter's steps at key scans, and the odometry
    is known to have failed there.
    """
    config = Config()
    rng = np.random.default_rng(seed)
    simulation = simulate(world, rng)
    (block,) = simulation.blocks(len(simulation.stamps_ns))
    keys = _keys(simulation.truth)
    block = replace(
        block,
        stamps_ns=block.stamps_ns[keys],
        ranges=block.ranges[keys],
        odometry=block.odometry[keys],
        has_odometry=block.has_odometry[keys],
    )
    truth = simulation.truth[keys]
    steps = se2.log(se2.between(truth[:-1], truth[1:]))
    steps[:, 2] += curvature * steps[:, 0]
    steps[:, :2] *= 1.0 + scale
    noise = rng.standard_normal(steps.shape)
    noise *= np.array([0.01, 0.01, 0.01]) * np.sqrt(np.abs(steps[:, :1]) + 0.05)
    poses, odometry = [truth[0]], [np.zeros(3)]
    for k, (step, error) in enumerate(zip(steps, noise, strict=True), start=1):
        moved = se2.exp(step)
        if faults and k in faults:
            moved = se2.compose(moved, faults[k])
        poses.append(se2.compose(poses[-1], moved))
        odometry.append(se2.exp(step + error))
    views = scan_views(segment_block(block, config.laser, config.segmentation), len(block))
    record = KeyScanRecord()
    for k, view in enumerate(views):
        trusted = not (faults and k in faults)
        walls = np.zeros(len(view.length), dtype=np.int64)  # of walls known, whichever they are
        record.add(int(block.stamps_ns[k]), 0, odometry[k], view, walls, trusted=trusted)
    return Drive(record.taken(), truth, np.array(poses))


def _keys(truth: Array) -> NDArray[np.int64]:
    chosen = [0]
    for k in range(1, len(truth)):
        step = se2.between(truth[chosen[-1]], truth[k])
        if np.hypot(step[0], step[1]) >= KEY or abs(step[2]) >= KEY_ANGLE:
            chosen.append(k)
    return np.array(chosen)


def comb(rooms: int, pitch: float = 4.0, *, alike: bool = True) -> World:
    """A corridor with rooms along it; the robot visits each one, then each one again.

    All rooms are alike, with a cupboard in the same place, or each has one of its own.
    """
    width = rooms * pitch
    areas = [{"id": "C", "kind": "corridor", "box": [0.0, 0.0, width, 2.0]}]
    doors, furniture, way = [], [], [[0.8, 1.0]]
    for k in range(rooms):
        x = k * pitch
        areas.append({"id": f"R{k}", "box": [x, 2.0, x + pitch, 6.0]})
        doors.append({"id": f"D{k}", "areas": ["C", f"R{k}"], "at": [x + 0.5 * pitch, 2.0]})
        y = 4.0 if alike else 3.2 + 1.9 * ((k * 7) % 10) / 10.0
        furniture.append({"box": [x + 0.1, y, x + 0.9, y + 0.7]})
        way += [[x + 0.5 * pitch, p] for p in (1.0, 2.6, 4.4, 2.6, 1.0)]
    way += [[width - 0.8, 1.0], *way[:0:-1], [0.8, 1.0]]
    return world_of(areas=areas, doors=doors, furniture=furniture, way_points=way)


def twins(pitch: float, length: float) -> World:
    """Two rooms alike side by side: the robot leaves one, goes a long way, enters the other."""
    height = 14.0
    areas = [
        {"id": "S", "kind": "corridor", "box": [0.0, 0.0, length, 2.0]},
        {"id": "N", "kind": "corridor", "box": [0.0, height - 2.0, length, height]},
        {"id": "W", "kind": "corridor", "box": [0.0, 2.0, 2.0, height - 2.0]},
        {"id": "E", "kind": "corridor", "box": [length - 2.0, 2.0, length, height - 2.0]},
    ]
    doors = [
        {"id": f"{v}{h}", "areas": [v, h], "at": [x, y], "width": 1.6}
        for v, y in (("S", 2.0), ("N", height - 2.0))
        for h, x in (("W", 1.0), ("E", length - 1.0))
    ]
    furniture = []
    for name, x in (("A", 8.0), ("B", 8.0 + pitch)):
        areas.append({"id": name, "box": [x, 2.0, x + pitch, 6.0]})
        doors.append({"id": f"D{name}", "areas": ["S", name], "at": [x + 0.5 * pitch, 2.0]})
        furniture.append({"box": [x + 0.1, 4.4, x + 0.9, 5.1]})
    a = 8.0 + 0.5 * pitch
    ring = [[1.0, 1.0], [1.0, height - 1.0], [length - 1.0, height - 1.0], [length - 1.0, 1.0]]
    way = [*_round(a), [a, 1.0], *ring, [a + pitch, 1.0], *_round(a + pitch)]
    return world_of(
        areas=areas, doors=doors, furniture=furniture, way_points=way, laser={"range_max": 8.0}
    )


def _round(x: float) -> list[list[float]]:
    """Way points in a room whose door is at x, long enough for several fragments."""
    places = ((0, 3), (-0.6, 4), (0.7, 4.2), (0.7, 3.2), (-0.7, 3.1), (-0.6, 4.1), (0.6, 4.0))
    places += ((0.6, 3.1), (-0.7, 3.2), (-0.6, 4.1), (0.0, 3.0))
    return [[x + dx, y] for dx, y in places]


def blank_corridor() -> World:
    """A corridor whose ends are out of sight all the way there and back."""
    return world_of(
        areas=[{"id": "C", "kind": "corridor", "box": [0.0, 0.0, 50.0, 2.0]}],
        way_points=[[12.0, 1.0], [38.0, 1.0], [12.0, 1.0]],
        laser={"range_max": 8.0},
    )
