"""Monte Carlo of a robot that has accidents: what each costs, against the run without it.

    python tests/real/faults.py [SCENARIO...] [--seeds 10] [--worlds room,ring,office]

Every scenario is run in simulated worlds over seeds. Printed are how far the robot is off at the
end and at worst (metres, aligned at the first pose), areas and doors, and what the run noticed.
A run has *failed* where the robot is off by more than 0.3 m at the end.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hiermap_cli.config import Config
from hiermap_cli.errors import ConfigurationError
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.run import map_log
from hiermap_cli.simulation.simulator import simulate
from hiermap_cli.simulation.world import build_world, load_world

if TYPE_CHECKING:
    from hiermap_cli.simulation.spec import WorldSpec
    from hiermap_cli.simulation.world import World

DATASETS = Path(__file__).resolve().parents[2] / "datasets"
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
SCENARIOS = ("none", "bend", "jump", "reversed", "missing", "people", "lifted")
NOTICED = (
    "odometry_reversed", "odometry_missing", "odometry_failed", "relocated", "lost",
    "area_recognised",
)  # fmt: skip
FAILED = 0.3  # metres off at the end
FAR = (2.5, 3.5)  # metres that a lifted robot is put down away


def spoilt(spec: WorldSpec, scenario: str) -> World:
    """The world with an accident."""
    if scenario == "lifted":
        return lifted(spec)
    wheels = spec.odometry.model_dump()
    whole = build_world(spec).journey.end
    change: dict[str, Any] = {}
    if scenario == "bend":
        wheels["bends"] = [{"after": 4, "bend": [0.4, 0.0, 0.0873]}]
    elif scenario == "jump":
        wheels["bends"] = [{"after": 4, "bend": [1.2, 0.3, 0.5]}]
    elif scenario in ("reversed", "missing"):
        begin, length = 0.6 * whole, 8.0 if scenario == "reversed" else 3.0
        wheels["faults"] = [{"kind": scenario, "begin": begin, "end": begin + length}]
    elif scenario == "people":
        change["people"] = {"number": 10}
    return build_world(type(spec).model_validate({**_plain(spec), "odometry": wheels, **change}))


def lifted(spec: WorldSpec) -> World:
    """The robot is put down where it has been before, some 3 m away, facing as it did there."""
    journey = build_world(spec).journey
    times = np.arange(0.0, journey.end, 0.5)
    poses = journey.poses(times)
    for k in range(int(0.55 * len(times)), len(times)):
        far = np.hypot(*(poses[:k, :2] - poses[k, :2]).T)
        for i in np.flatnonzero((far > FAR[0]) & (far < FAR[1]))[:-10]:
            lift = {"at": float(times[k]), "to": poses[i].tolist()}
            try:
                return build_world(type(spec).model_validate({**_plain(spec), "lifts": [lift]}))
            except ConfigurationError:
                continue
    raise AssertionError("nowhere to put the robot down")


def _plain(spec: WorldSpec) -> dict[str, Any]:
    plain: dict[str, Any] = spec.model_dump(exclude_none=True)
    return plain


def one(name: str, scenario: str, seed: int) -> dict[str, Any]:
    """The figures of one run."""
    world = spoilt(load_world(DATASETS / f"{name}.yaml").spec, scenario)
    simulation = simulate(world, np.random.default_rng(seed))
    result = map_log(simulation.blocks(), Config())
    off = {}
    for track, trajectory in (("final", result.trajectory), ("filter", result.trajectory_filter)):
        R_t_g = se2.compose(simulation.truth[0], se2.invert(trajectory.poses[0]))
        error = se2.compose(R_t_g, trajectory.poses)[:, :2] - simulation.truth[:, :2]
        distance = np.hypot(*error.T)
        off[track] = (float(distance[-1]), float(np.sqrt(np.mean(distance**2))))
    return {
        "seed": seed,
        "off": off,
        "areas": len(result.model.areas),
        "doors": len(result.model.environment.doors),
        "events": Counter(event.kind for event in result.events),
        "calibration": {m.name: m.value for m in result.metrics},
    }


def report(name: str, scenario: str, rows: list[dict[str, Any]]) -> str:
    """One line of the table for each track."""
    lines = []
    for track in ("final", "filter"):
        end, rms = np.array([row["off"][track] for row in rows]).T
        lines.append(
            f"{name:7} {scenario:9} {track:7} end {np.median(end):.3f} worst {end.max():.3f}"
            f" (seed {rows[int(end.argmax())]['seed']})  rms {np.median(rms):.3f}"
            f"  failed {int((end > FAILED).sum())} of {len(rows)}"
        )
    areas = Counter(row["areas"] for row in rows)
    doors = Counter(row["doors"] for row in rows)
    seen: Counter[str] = sum((row["events"] for row in rows), Counter())
    lines[-1] += (
        f"  areas {dict(sorted(areas.items()))} doors {dict(sorted(doors.items()))}"
        f"  {', '.join(f'{kind} {seen[kind]}' for kind in NOTICED if seen[kind])}"
    )
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description="Monte Carlo of accidents in simulated worlds")
    parser.add_argument("scenarios", nargs="*", default=SCENARIOS, help=", ".join(SCENARIOS))
    parser.add_argument("--worlds", default="room,ring,office")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    os.environ.update(ONE_THREAD)
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        for name in given.worlds.split(","):
            for scenario in given.scenarios:
                jobs = [pool.submit(one, name, scenario, seed) for seed in range(given.seeds)]
                sys.stdout.write(report(name, scenario, [job.result() for job in jobs]) + "\n")
                sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
