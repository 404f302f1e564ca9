"""One run of the program on a real log or a simulated world, and all figures about it.

    python tests/real/runs.py NAME [--config FILE]

prints them as one JSON object. Every run is a process of its own, so that processor time and
peak memory are the run's; both are taken when the map is made, before anything is judged.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hiermap_cli.config import Config
from hiermap_cli.configfile import load_config

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from hiermap_cli.documents.reference import ReferenceMap
    from hiermap_cli.documents.tum import TimedPoses
    from hiermap_cli.logs.records import ScanBlock
    from hiermap_cli.mapping.model import MapResult, Trajectory
    from hiermap_cli.simulation.simulator import Simulation

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data"
DATASETS = ROOT / "datasets"


@dataclass(frozen=True)
class RealLog:
    """A log and what is known of it; paths are relative to the folder of the real logs."""

    log: str
    truth: str | None = None
    relations: str | None = None
    reference: str | None = None


REAL_LOGS = {
    "fr079": RealLog(
        "fr079/log.carmen.gz",
        "fr079/slam_reference.tum",
        "fr079/relations.txt",
        "fr079/reference.json",
    ),
    "fr079_unsigned": RealLog(
        "fr079_unsigned/log.carmen.gz",
        "fr079/slam_reference.tum",
        "fr079/relations.txt",
        "fr079/reference.json",
    ),
    "csail": RealLog("csail/log.carmen.gz", "csail/slam_reference.tum"),
    "aces": RealLog("aces/log.carmen.gz", "aces/slam_reference.tum"),
    **{f"wean{i}": RealLog(f"wean/robotdata{i}.log.gz") for i in range(1, 6)},
    "neato_rosbag2": RealLog("neato_rosbag2"),
}


def names() -> list[str]:
    """All runs that can be made here: the real logs that are present, and the worlds."""
    real = [name for name, run in REAL_LOGS.items() if (DATA / run.log).exists()]
    return real + sorted(path.stem for path in DATASETS.glob("*.yaml") if path.name != "jobs.yaml")


class Watched:
    """Blocks on their way into the mapper; keeps the odometry and the laser's view.

    It can be gone through again if the blocks can.
    """

    def __init__(self, blocks: Iterable[ScanBlock]) -> None:
        self._blocks = blocks
        self._stamps: list[NDArray[np.int64]] = []
        self._odometry: list[NDArray[np.float64]] = []
        self.field_of_view = 2.0 * math.pi
        self.reach = math.inf

    def __iter__(self) -> Iterator[ScanBlock]:
        self._stamps, self._odometry = [], []
        for block in self._blocks:
            self._stamps.append(block.stamps_ns)
            self._odometry.append(block.odometry)
            angles = block.laser.angles() + block.mount.yaw
            if abs(angles[0] + angles[-1]) < 0.05:  # only a view that is symmetric can be told
                self.field_of_view = float(abs(angles[-1] - angles[0]))
            self.reach = block.laser.range_max
            yield block

    def odometry(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Stamps (N,) and raw odometry (N, 3) at every scan."""
        return np.concatenate(self._stamps), np.concatenate(self._odometry)


class Source(NamedTuple):
    """A log or a simulated world, ready to be run."""

    name: str
    watched: Watched
    simulation: Simulation | None = None


def opened(name: str, config: Config, seed: int = 0) -> Source:
    """A real log, read as it is gone through, or a world, simulated here and now."""
    if name in REAL_LOGS:
        from hiermap_cli.logs.recording import open_recording

        recording = open_recording([DATA / REAL_LOGS[name].log], config.input)
        return Source(name, Watched(recording.blocks()))
    from hiermap_cli.simulation.simulator import simulate
    from hiermap_cli.simulation.world import load_world

    world = load_world(DATASETS / f"{name}.yaml")
    simulation = simulate(world, np.random.default_rng(seed))
    return Source(name, Watched(list(simulation.blocks())), simulation)


def measure(name: str, config: Config, seed: int = 0, save: Path | None = None) -> dict[str, Any]:
    """Makes the map of a real log or world and judges it; `save` is a folder for its files."""
    from hiermap_cli.mapping.run import map_log

    source = opened(name, config, seed)  # a world is simulated before the clock starts
    made = time.process_time() if source.simulation is not None else 0.0
    result = map_log(source.watched, config)
    seconds = time.process_time() - made
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    if save is not None:
        from hiermap_cli.documents.results import write_result

        (save / name).mkdir(parents=True, exist_ok=True)
        write_result(save / name, result)
    scans = len(source.watched.odometry()[0])
    return {
        "name": name,
        "scans": scans,
        "milliseconds_a_scan": 1e3 * seconds / scans,
        "peak_megabytes": peak,
        "seconds": seconds,
        "stages": result.timing,
        **judged(source, result),
    }


def judged(source: Source, result: MapResult) -> dict[str, Any]:
    """What the map says of itself, and how right it is by all that is known of the log."""
    watched, simulation = source.watched, source.simulation
    figures = _own_figures(result)
    tracks = {
        "odometry": watched.odometry(),
        "filter": _poses(result.trajectory_filter),
        "final": _poses(result.trajectory),
    }
    if simulation is None:
        _judge_real(figures, REAL_LOGS[source.name], tracks, result, watched)
    else:
        from hiermap_cli.documents.tum import TimedPoses

        truth = TimedPoses(simulation.stamps_ns, simulation.truth)
        _judge_trajectories(figures, tracks, truth)
        _judge_map(figures, result, simulation.reference_map, truth, watched)
        _judge_consistency(figures, result, simulation.reference_map, truth)
    return figures


def _poses(trajectory: Trajectory) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    return trajectory.stamps_ns, trajectory.poses


def _own_figures(result: MapResult) -> dict[str, Any]:
    """What the run says of itself."""
    from hiermap_cli.evaluation.consistency import position_sigmas

    model = result.model
    own = {metric.name: metric.value for metric in result.metrics}
    return {
        "areas": len(model.areas),
        "doors": len(model.environment.doors),
        "landmarks": dict(sorted(Counter(l.kind for l in model.landmarks).items())),
        "events": dict(sorted(Counter(event.kind for event in result.events).items())),
        "sigma_median": float(np.median(position_sigmas(result.trajectory.covariances))),
        "own": own,
    }


def _judge_real(
    figures: dict[str, Any],
    run: RealLog,
    tracks: dict[str, Any],
    result: MapResult,
    watched: Watched,
) -> None:
    from hiermap_cli.documents.reference import read_reference
    from hiermap_cli.documents.relations import read_relations
    from hiermap_cli.documents.tum import read_tum
    from hiermap_cli.evaluation.relations import relations_metrics

    if run.relations is not None:
        true = read_relations(DATA / run.relations)
        for track, poses in tracks.items():
            for span, name in ((10.0, "relations_10s"), (None, "relations")):
                found = relations_metrics(*poses, true, span)
                figures.setdefault(name, {})[track] = {
                    "trans_mean": found.trans_mean,
                    "rot_mean_deg": math.degrees(found.rot_mean),
                    "n": found.n,
                }
    if run.truth is not None:
        truth = read_tum(DATA / run.truth)
        _judge_trajectories(figures, tracks, truth)
        if run.reference is not None:
            reference = read_reference(DATA / run.reference)
            _judge_map(figures, result, reference, truth, watched)


def _judge_trajectories(figures: dict[str, Any], tracks: dict[str, Any], truth: TimedPoses) -> None:
    from hiermap_cli.evaluation.trajectory import ate

    figures["ate_rmse"] = {name: ate(*poses, *truth).rmse for name, poses in tracks.items()}
    figures["ate_max"] = {name: ate(*poses, *truth).max for name, poses in tracks.items()}


def _judge_map(
    figures: dict[str, Any],
    result: MapResult,
    reference: ReferenceMap,
    truth: TimedPoses,
    watched: Watched,
) -> None:
    """All map metrics, and the counts behind those of areas and doors."""
    from hiermap_cli.evaluation.against import map_metrics
    from hiermap_cli.evaluation.areas import area_metrics
    from hiermap_cli.evaluation.doors import door_metrics
    from hiermap_cli.evaluation.placed import place
    from hiermap_cli.evaluation.trajectory import ate
    from hiermap_cli.evaluation.visibility import View

    view = View(watched.reach, watched.field_of_view)
    metrics = map_metrics(result.model, result.trajectory, reference, truth, view)
    figures["map"] = {metric.name: metric.value for metric in metrics}
    best = ate(*_poses(result.trajectory), *truth)
    if best.n == 0:
        return
    placed = place(result.model, best.alignment)
    areas = area_metrics(placed, reference, truth.poses[:0])  # what was seen matters not here
    doors = door_metrics(placed, reference)
    if areas is not None:
        figures["areas_matched"] = {
            "matched": len(areas.matches),
            "asked": areas.asked,
            "f1": areas.f1_iou50,
            "pairs": [[m.model, m.reference, round(m.iou, 3)] for m in areas.matches],
        }
    if doors is not None:
        counts = doors.detections
        figures["doors_matched"] = {"matched": counts.matched, "asked": counts.asked}


def _judge_consistency(
    figures: dict[str, Any], result: MapResult, reference: ReferenceMap, truth: TimedPoses
) -> None:
    """NEES where the truth is known; `nees_landmarks` is among the map metrics already."""
    from hiermap_cli.evaluation.consistency import robot_nees

    figures["nees_robot"] = robot_nees(result.trajectory, *truth).mean
    figures["nees_robot_filter"] = robot_nees(result.trajectory_filter, *truth).mean
    figures["visited"] = {
        "areas": sum(area.visited for area in reference.areas or ()),
        "doors": sum(door.visited for door in reference.doors or ()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="one run and its figures as JSON")
    parser.add_argument("name")
    parser.add_argument("--config", type=Path)
    parser.add_argument("--seed", type=int, default=0, help="of a simulated world")
    parser.add_argument("--save", type=Path, help="folder to write model and trajectories into")
    given = parser.parse_args()
    config = Config() if given.config is None else load_config(given.config)
    figures = measure(given.name, config, given.seed, given.save)
    json.dump(_plain(figures), sys.stdout, allow_nan=False)


def _plain(value: Any) -> Any:
    """Without numbers that JSON has no word for: they become null."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


if __name__ == "__main__":
    main()
