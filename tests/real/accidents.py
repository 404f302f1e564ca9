"""How often a map comes right: as it is, with ten people walking about, with the robot lifted once.

    python tests/real/accidents.py [WORLD...] [--scenarios plain,people,lifted] [--seeds 50]

prints a line a run and the rate of success of every scenario. A run has come right where the areas
and doors are those of the floor plan that the robot was in and drove through, and the robot is off
by less than 5 cm at the end (10 cm on the office floor). It is lifted at any time of its way and
put down 3 m away, in the same room or in another. Further scenarios are of odometry that lies:
`bend` (40 cm and 5 degrees, the accident of the paper's figure 8), `jump` (1.2 m and 0.5 rad),
`reversed` (8 s), `missing` (3 s).

All of it, 300 runs, takes about 20 minutes on two cores: 2 s a run in the ring, 9 s in the office.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from accident_cases import BARS, SCENARIOS, Outcome, outcome
from world_cases import DATASETS

from hiermap_cli.simulation.world import load_world

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def one(name: str, scenario: str, seed: int) -> tuple[Outcome, float]:
    """What came of a run, and the seconds of processor time that it took."""
    begin = time.process_time()
    came = outcome(load_world(DATASETS / f"{name}.yaml").spec, scenario, seed)
    return came, time.process_time() - begin


def main() -> int:
    parser = argparse.ArgumentParser(description="success rates with and without accidents")
    parser.add_argument("worlds", nargs="*", default=["ring", "office"], help=", ".join(BARS))
    parser.add_argument("--scenarios", default="plain,people,lifted", help=", ".join(SCENARIOS))
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    os.environ.update(ONE_THREAD)  # for the workers, which are started anew
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    rates = []
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        for name in given.worlds:
            for scenario in given.scenarios.split(","):
                jobs = {seed: pool.submit(one, name, scenario, seed) for seed in seeds}
                right, worst, noticed = 0, 0.0, Counter[str]()
                for seed, job in jobs.items():
                    came, seconds = job.result()
                    well = came.success(BARS[name])
                    right, worst = right + well, max(worst, came.end)
                    noticed.update(came.noticed)
                    sys.stdout.write(
                        f"{name:7} {scenario:8} {seed:3} {'right' if well else 'WRONG'}"
                        f"  end {came.end:.3f} m  {seconds:4.1f} s  {came.wrong}\n"
                    )
                    sys.stdout.flush()
                rates.append(
                    f"{name:7} {scenario:8} right {right} of {len(seeds)}, worst end {worst:.3f} m"
                    f"  {', '.join(f'{kind} {n}' for kind, n in sorted(noticed.items()))}"
                )
    sys.stdout.write("\n".join(["", *rates]) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
