"""Scans of straight walls, cast without any code of the program: for tests of segmentation."""

from __future__ import annotations

import numpy as np

from hiermap_cli.logs.records import LaserGeometry, Mount, ScanBlock

HALF = LaserGeometry(-np.pi / 2, np.radians(0.5), 361, 0.02, 80.0)
FULL = LaserGeometry(-np.pi, np.radians(0.5), 720, 0.02, 80.0)
COARSE = LaserGeometry(-np.pi / 2, np.radians(1.0), 181, 0.02, 80.0)

# A room of 6 m x 4 m with a box in it, a door of 0.9 m in its right wall (0.2 m thick), and a
# farther wall behind the door.
ROOM = [
    (0.0, 0.0, 6.0, 0.0),
    (6.0, 0.0, 6.0, 1.5),
    (6.0, 2.4, 6.0, 4.0),
    (6.0, 4.0, 0.0, 4.0),
    (0.0, 4.0, 0.0, 0.0),
    (6.0, 1.5, 6.2, 1.5),
    (6.0, 2.4, 6.2, 2.4),
    (10.0, -2.0, 10.0, 6.0),
    (2.0, 1.0, 2.8, 1.0),
    (2.8, 1.0, 2.8, 1.6),
    (2.8, 1.6, 2.0, 1.6),
    (2.0, 1.6, 2.0, 1.0),
]


def cast(walls, pose, angles):
    """Ranges (n,) from a laser at `pose` along `angles` in its own frame, inf where nothing is."""
    x1, y1, x2, y2 = np.asarray(walls, dtype=float).T
    heading = pose[2] + angles[:, None]
    dx, dy = np.cos(heading), np.sin(heading)
    ex, ey, wx, wy = x2 - x1, y2 - y1, x1 - pose[0], y1 - pose[1]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        across = dx * ey - dy * ex
        t = (wx * ey - wy * ex) / across
        u = (wx * dy - wy * dx) / across
    met = (t > 1e-9) & (u >= 0.0) & (u <= 1.0) & np.isfinite(t)
    return np.where(met, t, np.inf).min(axis=1)


def laser_pose(pose, mount):
    """The laser in the world of a robot at `pose`."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    x = pose[0] + c * mount.x - s * mount.y
    y = pose[1] + s * mount.x + c * mount.y
    return x, y, pose[2] + mount.yaw


def scans(walls, poses, laser=HALF, mount=None):
    """Noiseless ranges (n, beams) of a robot at each of `poses`."""
    mount = mount or Mount()
    angles = -laser.angles() if mount.flipped else laser.angles()
    ranges = np.array([cast(walls, laser_pose(pose, mount), angles) for pose in poses])
    return np.where(ranges >= laser.range_max, np.inf, ranges)


def block(ranges, laser=HALF, mount=None):
    """A block of ranges (n, beams)."""
    n = len(ranges)
    return ScanBlock(
        np.arange(n, dtype=np.int64) * 100_000_000,
        np.asarray(ranges, dtype=np.float32),
        np.zeros((n, 3)),
        np.ones(n, dtype=bool),
        laser,
        mount or Mount(),
    )


def in_world(segments, poses):
    """p1, p2 and centre (S, 2) and alpha (S,) of segments in the frame of the walls."""
    pose = np.asarray(poses, dtype=float)[segments.scan]
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])

    def moved(p):
        x = pose[:, 0] + c * p[:, 0] - s * p[:, 1]
        return np.stack((x, pose[:, 1] + s * p[:, 0] + c * p[:, 1]), axis=1)

    return (
        moved(segments.p1),
        moved(segments.p2),
        moved(segments.centre),
        segments.alpha + pose[:, 2],
    )


def line_errors(segments, poses, walls):
    """Errors of the angle and of the offset at the centre (S,), (S,) against the nearest wall."""
    _, _, centre, alpha = in_world(segments, poses)
    walls = np.asarray(walls, dtype=float)
    step = walls[:, 2:] - walls[:, :2]
    length = np.hypot(*step.T)
    t = step / length[:, None]
    n = np.stack((t[:, 1], -t[:, 0]), axis=1)
    beta = np.arctan2(n[:, 1], n[:, 0])
    # Both sides of each wall: the normal that is nearer to the segment's.
    turn = (alpha[:, None] - beta + np.pi / 2) % np.pi - np.pi / 2
    side = np.sign(np.cos(alpha[:, None] - beta))
    off = ((centre[:, None] - walls[:, :2]) * n).sum(axis=2) * side
    along = ((centre[:, None] - walls[:, :2]) * t).sum(axis=2)
    there = (np.abs(turn) < 0.2) & (along > -0.1) & (along < length + 0.1)
    wall = np.argmin(np.where(there, np.abs(off), np.inf), axis=1)
    row = np.arange(len(wall))
    assert there[row, wall].all(), "a segment where no wall is"
    return turn[row, wall], off[row, wall]
