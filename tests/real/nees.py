"""Monte Carlo: whether the covariances of a simulated world's maps tell the truth.

    python tests/real/nees.py [WORLD.yaml] [--seeds 50] [--config FILE]

prints, over all seeds, the mean `nees_robot` and `nees_landmarks` (1 is honest, above it the
estimator believes itself too much), how small the covariances are, the error itself, and the
NEES of the robot along the run, where a slow rise shows inconsistency that a mean hides. The
single components are the squared error over its own variance: which of x, y, theta is at fault.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hiermap_cli.config import Config, LaserConfig
from hiermap_cli.configfile import load_config
from hiermap_cli.documents.tum import TimedPoses
from hiermap_cli.evaluation.consistency import (
    first_pose_alignment,
    landmark_nees,
    position_sigmas,
    robot_nees,
)
from hiermap_cli.evaluation.trajectory import ate
from hiermap_cli.geometry.se2 import compose, invert, wrap
from hiermap_cli.mapping.run import map_log
from hiermap_cli.simulation.simulator import simulate
from hiermap_cli.simulation.world import load_world

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.mapping.model import Trajectory
    from hiermap_cli.simulation.world import World

ROOM = Path(__file__).resolve().parents[2] / "datasets" / "room.yaml"
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
BINS = 10  # of the run's time, for the profile


def world_config(world: World, config: Config) -> Config:
    """The configuration with the noise that the world truly has, and walls that are lines."""
    laser, wheels = world.spec.laser, world.spec.odometry
    truly = {
        name: getattr(wheels, name)
        for name in type(config.odometry).model_fields
        if name.startswith("sigma_")
    }
    return config.model_copy(
        update={
            "laser": LaserConfig(
                sigma_range=max(laser.sigma, 1e-4), sigma_range_scale=laser.sigma_per_metre
            ),
            "odometry": config.odometry.model_copy(
                update={name: max(value, 1e-6) for name, value in truly.items()}
            ),
            "filter": config.filter.model_copy(
                update={"wall_sigma": 0.0, "wall_sigma_theta": 0.0, "end_sigma": 0.0}
            ),
        }
    )


def one(path: Path, config: Config, seed: int, *, true_noise: bool) -> dict[str, Any]:
    """The figures of one seed."""
    world = load_world(path)
    if true_noise:
        config = world_config(world, config)
    simulation = simulate(world, np.random.default_rng(seed))
    result = map_log(simulation.blocks(), config)
    truth = TimedPoses(simulation.stamps_ns, simulation.truth)
    figures: dict[str, Any] = {"seed": seed}
    for name, track in (("final", result.trajectory), ("filter", result.trajectory_filter)):
        nees = robot_nees(track, *truth)
        figures[name] = {
            "nees": nees.mean,
            "profile": _profile(nees.values).tolist(),
            "components": _components(track, truth).tolist(),
            "sigma": float(np.median(position_sigmas(track.covariances))),
            "ate": ate(track.stamps_ns, track.poses, *truth).rmse,
        }
    estimate = (result.trajectory.stamps_ns, result.trajectory.poses)
    R_t_g = first_pose_alignment(*estimate, *truth)
    best = ate(*estimate, *truth)
    assert R_t_g is not None
    landmarks = landmark_nees(result.model, simulation.reference_map, R_t_g, best.alignment)
    figures["landmarks"] = {"nees": landmarks.mean, "n": landmarks.n}
    figures["areas"] = len(result.model.areas)
    figures["doors"] = len(result.model.environment.doors)
    return figures


def _components(track: Trajectory, truth: TimedPoses) -> NDArray[np.float64]:
    """Mean squared error of x, y, theta over their own variances, (3,)."""
    R_t_g = first_pose_alignment(track.stamps_ns, track.poses, *truth)
    assert R_t_g is not None
    errors = track.poses - compose(invert(R_t_g), truth.poses)
    errors[:, 2] = wrap(errors[:, 2])
    variances = np.einsum("nii->ni", track.covariances)
    known = (variances > 1e-14).all(axis=1)
    return np.asarray((errors[known] ** 2 / variances[known]).mean(axis=0))


def _profile(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean NEES in each tenth of the run, nan where none is known, (BINS,)."""
    parts = np.array_split(values, BINS)
    means = [part[~np.isnan(part)].mean() if (~np.isnan(part)).any() else np.nan for part in parts]
    return np.array(means)


def report(rows: list[dict[str, Any]]) -> str:
    """The means over all seeds, as text."""
    lines = [f"{len(rows)} seeds"]
    for name in ("final", "filter"):
        tracks = [row[name] for row in rows]
        nees = np.array([track["nees"] for track in tracks])
        profile = np.nanmean([track["profile"] for track in tracks], axis=0)
        x, y, theta = np.mean([track["components"] for track in tracks], axis=0)
        lines.append(
            f"{name:7} nees_robot mean {nees.mean():.3f}  median {np.median(nees):.3f}"
            f"  worst {nees.max():.2f} (seed {rows[int(nees.argmax())]['seed']})"
            f"  x {x:.2f} y {y:.2f} theta {theta:.2f}"
        )
        lines.append(
            f"        median sigma {np.median([t['sigma'] for t in tracks]):.4f} m"
            f"  ATE mean {np.mean([t['ate'] for t in tracks]):.4f} m"
            f"  worst {np.max([t['ate'] for t in tracks]):.4f} m"
        )
        lines.append("        along the run " + " ".join(f"{value:.2f}" for value in profile))
    counts = np.array([row["landmarks"]["n"] for row in rows])
    landmarks = np.array([row["landmarks"]["nees"] for row in rows])
    if counts.any():
        lines.append(
            f"nees_landmarks mean {np.nanmean(landmarks):.3f}"
            f"  median {np.nanmedian(landmarks):.3f}  worst {np.nanmax(landmarks):.2f}"
            f"  matched {counts.mean():.1f} a run"
        )
    else:
        lines.append("nees_landmarks: no corner or door of the model matches a true one")
    areas, doors = ([row[key] for row in rows] for key in ("areas", "doors"))
    lines.append(f"areas {_counts(areas)}  doors {_counts(doors)}")
    return "\n".join(lines)


def _counts(values: list[int]) -> str:
    """How often each number came out: `1 x50`."""
    return ", ".join(f"{value} x{values.count(value)}" for value in sorted(set(values)))


def main() -> int:
    parser = argparse.ArgumentParser(description="Monte Carlo of a simulated world")
    parser.add_argument("world", type=Path, nargs="?", default=ROOM)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--config", type=Path)
    parser.add_argument(
        "--true-noise", action="store_true", help="the world's own noise figures, nothing added"
    )
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", action="store_true", help="all figures of all seeds")
    given = parser.parse_args()
    config = Config() if given.config is None else load_config(given.config)
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    os.environ.update(ONE_THREAD)  # for the workers, which are started anew
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        jobs = [
            pool.submit(one, given.world, config, seed, true_noise=given.true_noise)
            for seed in seeds
        ]
        rows = [job.result() for job in jobs]
    sys.stdout.write((json.dumps(rows, indent=1) if given.json else report(rows)) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
