"""Processor time and memory of whole runs, interpreter start included; stages apart.

`make bench` writes them down as JSON; nothing is asserted about time.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from real_data import DATA
from world_cases import DATASETS

from hiermap_cli.documents.model_load import load_model
from hiermap_cli.simulation.floors import office_floor
from hiermap_cli.simulation.output import LOG, write
from hiermap_cli.simulation.simulator import simulate

pytestmark = pytest.mark.bench

FR079 = DATA / "fr079" / "log.carmen.gz"
BYTECODE = Path(tempfile.gettempdir()) / "hiermap_bench_bytecode"
LONG_SCANS = 200_000
LONG_BLOCKS = 20  # of an office floor: 200 areas
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class Cost(NamedTuple):
    """Of one process: seconds of processor time, and the most memory that it held."""

    seconds: float
    peak_megabytes: float


def hiermap(*arguments: object) -> Cost:
    command = [sys.executable, "-m", "hiermap_cli", *map(str, arguments)]
    # An installed program has its bytecode: where none may be written beside the sources, each
    # start would compile all modules anew, which is no cost of the program.
    kept = {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": str(BYTECODE)}
    process = subprocess.Popen(command, env={**os.environ, **ONE_THREAD, **kept})
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0
    return Cost(usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def run_and_note(benchmark, log: Path, folder: Path, rounds: int, *options: str) -> None:
    """Runs a log some times; the report's stages and the cheapest run go into the JSON."""
    costs = []

    def once() -> None:
        costs.append(hiermap("run", log, "-o", folder, "--force", "--quiet", *options))

    benchmark.pedantic(once, rounds=rounds)
    report = json.loads((folder / "report.json").read_text())
    scans = report["input"]["scans"]
    best = min(cost.seconds for cost in costs)
    benchmark.extra_info |= {
        "scans": scans,
        "processor_seconds": best,
        "processor_ms_per_scan": 1e3 * best / scans,
        "peak_megabytes": max(cost.peak_megabytes for cost in costs),
        "stages_seconds": report["timing"],
        "stages_ms_per_scan": {k: 1e3 * v / scans for k, v in report["timing"].items()},
    }


def test_start(benchmark):
    """The interpreter and `--help`."""
    benchmark.pedantic(lambda: hiermap("--version"), rounds=5, warmup_rounds=1)


@pytest.mark.skipif(not FR079.exists(), reason="no real logs here")
@pytest.mark.parametrize("options", [("--no-refine",), ()], ids=["filter", "refined"])
def test_run_on_fr079(benchmark, tmp_path, options):
    run_and_note(benchmark, FR079, tmp_path / "out", 5, *options)


def test_run_on_the_ring(benchmark, tmp_path):
    run_and_note(benchmark, DATASETS / "ring" / LOG, tmp_path / "out", rounds=3)


@pytest.mark.parametrize("options", [("--no-refine",), ()], ids=["filter", "refined"])
def test_run_on_200000_scans(benchmark, tmp_path, options):
    floor = office_floor(LONG_BLOCKS, np.random.default_rng(1))
    rate = floor.spec.laser.rate * LONG_SCANS / len(simulated(floor).stamps_ns)
    floor = office_floor(LONG_BLOCKS, np.random.default_rng(1), laser={"rate": rate})
    write(simulated(floor), tmp_path)
    run_and_note(benchmark, tmp_path / LOG, tmp_path / "out", 1, *options)


def test_reading_a_model(benchmark, tmp_path):
    hiermap("run", DATASETS / "ring" / LOG, "-o", tmp_path / "out", "--quiet")
    model = benchmark(load_model, tmp_path / "out" / "model.json")
    assert model.areas


def simulated(floor):
    return simulate(floor, np.random.default_rng(1))
