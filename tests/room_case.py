"""A room without symmetry, a robot that drives in it, and what its laser sees: made here."""

from __future__ import annotations

import math

import numpy as np

from hiermap_cli.geometry.se2 import compose
from hiermap_cli.logs.mcap_writer import RosMcapWriter
from hiermap_cli.logs.ranges import float32
from hiermap_cli.logs.records import LaserGeometry, Mount

SECOND = 1_000_000_000
CENTRE = Mount()
STEP = SECOND // 5
CORNERS = [(0, 0), (9, 0), (9, 4), (6, 4), (6, 6), (2, 6), (2, 5), (0, 5)]
LASER = LaserGeometry(float32(-math.pi / 2), float32(math.pi / 360), 361, 0.0, float32(30.0))


def cast(pose, directions):
    """Distances from a pose to the walls, along directions in the pose's frame."""
    walls = np.array([*CORNERS, CORNERS[0]], dtype=float)
    a, edge = walls[:-1], np.diff(walls, axis=0)
    angles = pose[2] + directions
    d = np.stack((np.cos(angles), np.sin(angles)), axis=1)[:, None]
    away = a[None] - np.asarray(pose[:2])
    cross = d[..., 0] * edge[:, 1] - d[..., 1] * edge[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (away[..., 0] * edge[:, 1] - away[..., 1] * edge[:, 0]) / cross
        s = (away[..., 0] * d[..., 1] - away[..., 1] * d[..., 0]) / cross
    hit = (t > 1e-9) & (s >= 0.0) & (s <= 1.0)
    return np.where(hit, t, np.inf).min(axis=1)


def drive():
    """True poses (N, 3): forward, a turn on the spot, forward again, back a bit, many times."""
    poses = [np.array([2.5, 1.5, 0.1])]
    for turn in (1.2, 1.5, 1.7, 1.2, 1.6, -1.4, 1.3, 1.0):
        poses += [advanced(poses[-1], 0.1 * i) for i in range(1, 15)]
        start = poses[-1]
        poses += [start + np.array([0.0, 0.0, turn * i / 12]) for i in range(1, 13)]
        start = poses[-1]
        poses += [advanced(start, -0.1 * i) for i in range(1, 5)]
    return np.array(poses)


def advanced(pose, distance):
    return compose(pose, np.array([distance, 0.0, 0.0]))


def write(path, *, real=CENTRE, stated=CENTRE, odometry=None, scale=1.0, poses=None):
    """A log of the drive. The laser is at `real`, the log says `stated`."""
    poses = drive() if poses is None else poses
    told = poses if odometry is None else odometry
    directions = -LASER.angles() if real.flipped else LASER.angles()
    laser = LASER._replace(range_max=float32(scale * 30.0))
    with RosMcapWriter(path, stated) as writer:
        for i, (pose, reading) in enumerate(zip(poses, told, strict=True)):
            writer.odometry(SECOND + i * STEP, reading)
            ranges = scale * cast(compose(pose, real.pose()), directions)
            writer.scan(SECOND + i * STEP, ranges, laser)
    return path
