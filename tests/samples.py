"""A small model as values and as files: two areas, a door between them, four landmarks."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np
from click.testing import CliRunner

from hiermap_cli.commands.main import cli
from hiermap_cli.config import Config
from hiermap_cli.documents.report_file import report_json
from hiermap_cli.documents.results import write_result
from hiermap_cli.geometry.se2 import compose
from hiermap_cli.mapping.model import (
    AreaModel,
    DoorModel,
    EnvironmentModel,
    Estimate,
    Event,
    HierarchicalModel,
    LandmarkModel,
    MapResult,
    Metric,
    PointFeature,
    SegmentFeature,
    Trajectory,
)

if TYPE_CHECKING:
    from pathlib import Path


def covariance(rng: np.random.Generator, size: int, scale: float = 0.01) -> np.ndarray:
    A = rng.normal(size=(size, size)) * scale
    return A @ A.T + 1e-8 * np.eye(size)


def corner(rng: np.random.Generator, id_: str, area: str, kind: str) -> LandmarkModel:
    joint = covariance(rng, 7)
    joint[3:5] = joint[:, 3:5] = 0.0  # the segment on the X axis is exactly known
    features = (
        SegmentFeature(0.0, 0.0, 1, joint[3:5, 3:5], np.array([[0.0, 0], [2, 0]]), (False, True)),
        SegmentFeature(
            0.02, 0.0, 0, joint[5:7, 5:7], np.array([[0.03, 1.5], [0, 0]]), (True, False)
        ),
    )
    robot = Estimate(id_, np.array([1.0, 1.0, -2.0]), joint[:3, :3])
    binds = ("x", "y", "theta")
    return LandmarkModel(id_, area, kind, binds, robot, features, joint, 12, 3.5)


def door_landmark(rng: np.random.Generator, id_: str, area: str) -> LandmarkModel:
    joint = covariance(rng, 7)
    features = (
        PointFeature(np.array([-0.45, 0.0]), joint[3:5, 3:5]),
        PointFeature(np.array([0.45, 0.0]), joint[5:7, 5:7]),
    )
    robot = Estimate(id_, np.array([0.0, -1.0, 1.5]), joint[:3, :3])
    return LandmarkModel(id_, area, "door", ("x", "y", "theta"), robot, features, joint, 4, 1.0)


def area(rng, id_: str, kind: str, door: str | None, poses: dict[str, list[float]]) -> AreaModel:
    joint = covariance(rng, 3 + 3 * len(poses))
    landmarks = tuple(
        (name, Estimate(id_, np.array(pose), joint[3 * i + 3 : 3 * i + 6, 3 * i + 3 : 3 * i + 6]))
        for i, (name, pose) in enumerate(poses.items())
    )
    robot = Estimate(id_, np.array([1.0, 0.5, 0.3]), joint[:3, :3])
    extent = np.array([[0.0, 0], [4, 0], [4, 3], [0, 3]])
    return AreaModel(id_, kind, door, robot, landmarks, joint, extent)


def sample_model(seed: int = 1) -> HierarchicalModel:
    rng = np.random.default_rng(seed)
    areas = (
        area(rng, "A1", "room", None, {"L1": [0, 0, 0], "L2": [4, 3, -3.1], "L3": [4, 1.5, -1.57]}),
        area(rng, "A2", "corridor", "D1", {"L4": [0.0, 1.5, 1.57]}),
    )
    joint = covariance(rng, 9)
    frames = ((0.5, 0.5, 0.1), (4.6, 0.7, 0.1))
    environment = EnvironmentModel(
        robot=Estimate("g", np.array([5.0, 1.0, 0.2]), joint[:3, :3]),
        areas=tuple(
            (
                one.id,
                Estimate(
                    "g", np.array(frames[i]), joint[3 * i + 3 : 3 * i + 6, 3 * i + 3 : 3 * i + 6]
                ),
            )
            for i, one in enumerate(areas)
        ),
        covariance=joint,
        doors=(
            DoorModel(
                "D1",
                ("A1", "A2"),
                ("L3", "L4"),
                0.9,
                Estimate(
                    "g", compose(np.array(frames[0]), np.array([4, 1.5, -1.57])), joint[:3, :3]
                ),
                2,
            ),
        ),
    )
    landmarks = (
        corner(rng, "L1", "A1", "corner_concave"),
        corner(rng, "L2", "A1", "corner_convex"),
        door_landmark(rng, "L3", "A1"),
        door_landmark(rng, "L4", "A2"),
    )
    return HierarchicalModel(environment, areas, landmarks)


def sample_trajectory(count: int, start_ns: int = 1_700_000_000_123_456_789) -> Trajectory:
    s = np.linspace(0.0, 1.0, count)
    poses = np.column_stack((5.0 * s, np.sin(4 * s), 3.0 * np.cos(3 * s)))
    stamps = start_ns + (np.arange(count, dtype=np.int64) * 100_000_001)
    base = covariance(np.random.default_rng(3), 3)
    return Trajectory(stamps, poses, base * s[:, None, None])


def sample_result(count: int = 50) -> MapResult:
    final = sample_trajectory(count)
    by_filter = Trajectory(
        final.stamps_ns, final.poses + np.array([0.01, 0.0, 0.0]), final.covariances
    )
    first = int(final.stamps_ns[0])
    return MapResult(
        model=sample_model(),
        trajectory=final,
        trajectory_filter=by_filter,
        events=(
            Event(first, "area_entered", {"area": "A1", "door": None}),
            Event(first + 2_000_000_000, "area_entered", {"area": "A2", "door": "D1"}),
        ),
        metrics=(Metric("matches", "1", 120.0, 140), Metric("matching_failures", "1", 3.0, 50)),
        timing={"segmentation": 0.1, "filter": 0.4},
        dropped={"too_far": 2},
    )


def report_of(result, **changes):
    source = {
        "log": "a.mcap",
        "sha256": "0" * 64,
        "scan_topic": "/scan",
        "odometry_topic": "/odom",
        "scans": 50,
        "odometry": 100,
        "dropped": {"repeated_stamp": 1},
    }
    values = {
        "source": source | changes.pop("source", {}),
        "config": Config(),
        "metrics": result.metrics,
        "events": result.events,
        "timing": result.timing,
    }
    return report_json(**(values | changes))


def write_sample(folder: Path) -> Path:
    """Every file of a run, with the sample in them."""
    result = sample_result()
    write_result(folder, result)
    (folder / "report.json").write_bytes(report_of(result))
    return folder


def same(a, b) -> bool:
    """Equal values, arrays included, bit for bit."""
    if isinstance(a, np.ndarray):
        return a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    if hasattr(a, "__dataclass_fields__"):
        return all(same(getattr(a, f), getattr(b, f)) for f in a.__dataclass_fields__)
    return a == b


def hiermap(*arguments) -> tuple[int, str, str]:
    result = CliRunner().invoke(cli, [str(a) for a in arguments])
    return result.exit_code, result.stdout, result.stderr


def program(*arguments, **options) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hiermap_cli", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())
