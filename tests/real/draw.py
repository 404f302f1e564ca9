"""Draws a run as a picture: scans at estimated poses, model, and what is truly there.

    python tests/real/draw.py LOG --result DIR -o map.png
    python tests/real/draw.py LOG --trajectory slam_reference.tum --reference reference.json
    python tests/real/draw.py LOG --result DIR --truth slam_reference.tum --reference reference.json

With `--truth`, a trajectory in the reference map's frame, everything is drawn in that frame, put
together by the best fit. For the developer: a figure can be good and the map wrong.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np

mpl.use("Agg")

from matplotlib import pyplot as plt
from matplotlib.patches import Ellipse

from hiermap_cli.config import InputConfig
from hiermap_cli.documents.model_load import load_model
from hiermap_cli.documents.reference import ReferenceMap, read_reference
from hiermap_cli.documents.tum import TimedPoses, read_tum
from hiermap_cli.evaluation.placed import landmark_points, move_points, place
from hiermap_cli.evaluation.trajectory import ate, poses_at
from hiermap_cli.geometry.se2 import compose, rotation
from hiermap_cli.logs.recording import open_recording

if TYPE_CHECKING:
    from collections.abc import Iterable

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from hiermap_cli.logs.records import ScanBlock
    from hiermap_cli.mapping.model import HierarchicalModel

    Array = NDArray[np.float64]

KIND_COLOURS = {
    "corner_concave": "tab:blue",
    "corner_convex": "tab:cyan",
    "door": "tab:red",
    "corridor": "tab:green",
    "crossing": "tab:purple",
}


@dataclass(frozen=True)
class Picture:
    """What to draw; all poses in one frame but for `R_d_g`, from there into the drawing's."""

    track: TimedPoses
    model: HierarchicalModel | None = None
    reference: ReferenceMap | None = None
    truth: TimedPoses | None = None
    R_d_g: Array = field(default_factory=lambda: np.zeros(3))
    window: tuple[float, float, float, float] | None = None
    title: str = ""
    labels: bool = True
    size: float = 24.0  # inches, the longer side


def robot_points(block: ScanBlock, scan: int) -> Array:
    """Valid returns of one scan of a block in the robot's frame, (n, 2)."""
    laser, mount = block.laser, block.mount
    ranges = block.ranges[scan].astype(float)
    angles = laser.angles() * (-1.0 if mount.flipped else 1.0)
    valid = np.isfinite(ranges)
    in_laser = ranges[valid, None] * np.column_stack((np.cos(angles[valid]), np.sin(angles[valid])))
    return move_points(mount.pose(), in_laser)


def scan_points(blocks: Iterable[ScanBlock], track: TimedPoses, most: int = 1_500_000) -> Array:
    """All returns at the poses of a trajectory, evenly thinned to at most about `most`, (n, 2)."""
    clouds = []
    for block in blocks:
        at, found = poses_at(*track, block.stamps_ns, 0.5)
        clouds.extend(
            move_points(at[i], robot_points(block, i)) for i in np.flatnonzero(found).tolist()
        )
    points = np.concatenate(clouds) if clouds else np.zeros((0, 2))
    return points[:: max(1, len(points) // most)]


def draw(picture: Picture, blocks: Iterable[ScanBlock], path: Path) -> None:
    """Writes the picture of a run as PNG; blocks are the log's scans, or nothing."""
    points = move_points(picture.R_d_g, scan_points(blocks, picture.track))
    way = compose(picture.R_d_g, picture.track.poses)
    window = picture.window or _bounds(points, way)
    width, height = window[2] - window[0], window[3] - window[1]
    scale = picture.size / max(width, height)
    figure = plt.figure(figsize=(max(width * scale, 6.0), max(height * scale, 4.0) + 0.5))
    axes = figure.add_subplot()
    axes.plot(points[:, 0], points[:, 1], ",", color="0.45", alpha=0.35, zorder=1)
    axes.plot(way[:, 0], way[:, 1], "-", color="tab:orange", linewidth=0.7, zorder=3)
    axes.plot(*way[0, :2], "o", color="tab:orange", markersize=5, zorder=3)
    if picture.reference is not None:
        _draw_reference(axes, picture.reference, labels=picture.labels)
    if picture.truth is not None:
        truth = picture.truth.poses
        axes.plot(truth[:, 0], truth[:, 1], "-", color="black", linewidth=0.5, zorder=3)
    if picture.model is not None:
        _draw_model(axes, picture.model, picture.R_d_g, labels=picture.labels)
    axes.set_xlim(window[0], window[2])
    axes.set_ylim(window[1], window[3])
    axes.set_aspect("equal")
    axes.grid(visible=True, linewidth=0.2)
    axes.set_title(picture.title)
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)


def _bounds(points: Array, way: Array) -> tuple[float, float, float, float]:
    """What holds nearly all points and the whole way, with a margin."""
    parts = [way[:, :2]]
    if len(points):
        parts.append(np.percentile(points, (0.2, 99.8), axis=0))
    both = np.concatenate(parts)
    (x1, y1), (x2, y2) = both.min(axis=0) - 1.0, both.max(axis=0) + 1.0
    return float(x1), float(y1), float(x2), float(y2)


def _draw_reference(axes: Axes, reference: ReferenceMap, *, labels: bool) -> None:
    """Walls and furniture in black and brown, areas dashed, doors as magenta bars."""
    for segments, colour in ((reference.walls, "black"), (reference.furniture, "tab:brown")):
        for x1, y1, x2, y2 in segments if segments is not None else ():
            axes.plot((x1, x2), (y1, y2), "-", color=colour, linewidth=0.8, zorder=4)
    for area in reference.areas or ():
        ring = np.vstack((area.polygon, area.polygon[:1]))
        axes.plot(ring[:, 0], ring[:, 1], "--", color="tab:green", linewidth=1.2, zorder=4)
        if labels:
            axes.text(*area.polygon.mean(axis=0), area.id, color="tab:green", fontsize=14, zorder=6)
    for door in reference.doors or ():
        bar = np.vstack((door.p1, door.p2))
        style = "-" if door.visited else ":"
        axes.plot(bar[:, 0], bar[:, 1], style, color="magenta", linewidth=3, zorder=5)
        if labels:
            axes.text(*bar.mean(axis=0), door.id, color="magenta", fontsize=9, zorder=6)


def _draw_model(axes: Axes, model: HierarchicalModel, R_d_g: Array, *, labels: bool) -> None:
    """Areas in colour, landmark segments, landmarks with ids and 3-sigma ellipses, doors."""
    placed = place(model, R_d_g)
    colours = mpl.colormaps["tab20"]
    for i, area in enumerate(placed.areas):
        if len(area.polygon) < 3:
            continue
        colour = colours(i % 20)
        axes.fill(*area.polygon.T, facecolor=(*colour[:3], 0.2), edgecolor=colour, zorder=2)
        if labels:
            text = f"{area.id} {model.areas[i].kind}"
            axes.text(*area.polygon.mean(axis=0), text, fontsize=12, zorder=6)
    for ends in placed.segments:
        axes.plot(ends[:, 0], ends[:, 1], "-", color="tab:blue", linewidth=1.0, zorder=4)
    points = landmark_points(model, model.landmarks).moved(R_d_g)
    for landmark, at, C in zip(model.landmarks, points.points, points.covariances, strict=True):
        colour = KIND_COLOURS.get(landmark.kind, "tab:gray")
        axes.plot(*at, ".", color=colour, markersize=4, zorder=5)
        if {"x", "y"} <= set(landmark.binds):
            axes.add_patch(_ellipse(at, C, colour))
        if labels:
            axes.text(*at, landmark.id, color=colour, fontsize=6, clip_on=True, zorder=6)
    for door in model.environment.doors:
        pose = compose(R_d_g, door.estimate.mean)
        half = 0.5 * door.width * rotation(pose[2])[:, 0]
        bar = np.vstack((pose[:2] - half, pose[:2] + half))
        axes.plot(bar[:, 0], bar[:, 1], "-", color="red", linewidth=2.5, zorder=5)
        if labels:
            text = f"{door.id} {door.areas[0]}-{door.areas[1]}"
            axes.text(*pose[:2], text, color="red", fontsize=9, zorder=6)


def _ellipse(at: Array, C: Array, colour: str) -> Ellipse:
    """Three standard deviations of a position."""
    values, axes = np.linalg.eigh(C)
    width, height = 6.0 * np.sqrt(np.maximum(values, 0.0))
    angle = float(np.degrees(np.arctan2(axes[1, 0], axes[0, 0])))
    return Ellipse(tuple(at), width, height, angle=angle, fill=False, color=colour, linewidth=0.6)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="draw a run as PNG")
    parser.add_argument("log", type=Path, nargs="*", help="the log; none draws no scans")
    parser.add_argument("--result", type=Path, help="folder of a run, with model.json")
    parser.add_argument("--filter", action="store_true", help="take trajectory_filter.tum of it")
    parser.add_argument("--trajectory", type=Path, help="draw the scans at these poses (TUM)")
    parser.add_argument("--odometry", action="store_true", help="draw the scans at raw odometry")
    parser.add_argument("--reference", type=Path, help="reference map to lay over")
    parser.add_argument("--truth", type=Path, help="trajectory in the reference's frame (TUM)")
    parser.add_argument("--window", help="x1,y1,x2,y2 in metres of the drawing")
    parser.add_argument("--no-labels", action="store_true")
    parser.add_argument("--size", type=float, default=24.0, help="inches of the longer side")
    parser.add_argument("-o", "--output", type=Path, default=Path("map.png"))
    return parser.parse_args()


def _track(given: argparse.Namespace) -> TimedPoses:
    """The trajectory to draw: as asked for, else the result's."""
    if given.trajectory is not None:
        return read_tum(given.trajectory)
    if given.odometry:
        blocks = list(open_recording(given.log, InputConfig()).blocks())
        return TimedPoses(
            np.concatenate([block.stamps_ns for block in blocks]),
            np.concatenate([block.odometry for block in blocks]),
        )
    if given.result is None:
        raise SystemExit("one of --result, --trajectory and --odometry is needed")
    name = "trajectory_filter.tum" if given.filter else "trajectory.tum"
    return read_tum(given.result / name)


def main() -> None:
    given = _arguments()
    track = _track(given)
    truth = None if given.truth is None else read_tum(given.truth)
    R_d_g = np.zeros(3)
    title = " ".join(path.name for path in given.log) or str(given.result)
    if truth is not None:
        fit = ate(*track, *truth)
        R_d_g = fit.alignment
        title += f", ATE rmse {fit.rmse:.3f} m, max {fit.max:.3f} m"
    window = None
    if given.window is not None:
        x1, y1, x2, y2 = (float(word) for word in given.window.split(","))
        window = (x1, y1, x2, y2)
    picture = Picture(
        track=track,
        model=None if given.result is None else load_model(given.result / "model.json"),
        reference=None if given.reference is None else read_reference(given.reference),
        truth=truth,
        R_d_g=R_d_g,
        window=window,
        title=title,
        labels=not given.no_labels,
        size=given.size,
    )
    blocks = open_recording(given.log, InputConfig()).blocks() if given.log else []
    draw(picture, blocks, given.output)


if __name__ == "__main__":
    main()
