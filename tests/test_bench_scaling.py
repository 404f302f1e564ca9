"""Processor time and memory of whole runs on 1, 2, 4 and 8 times the floor, and of the log.

Each run is a process of its own, refinement and writing included. `make bench` writes down what
a doubling costs; nothing is asserted about time.
"""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from test_bench_run import hiermap

from hiermap_cli.simulation.floors import office_floor
from hiermap_cli.simulation.output import LOG, write
from hiermap_cli.simulation.simulator import simulate

BLOCKS = (1, 2, 4, 8)
ROUNDS = 3  # the cheapest of them: other work on the machine only adds
MOST = 2.3  # times the cost for twice the floor, at most


def per_doubling(cost: float, before: float, scans: int, scans_before: int) -> float:
    """What a doubling costs, where a log has grown to a little more or less than its double."""
    return 2.0 ** (math.log(cost / before) / math.log(scans / scans_before))


def test_growth_is_told_for_a_doubling() -> None:
    assert per_doubling(6.0, 3.0, 200, 100) == pytest.approx(2.0)
    assert per_doubling(9.0, 1.0, 900, 100) == pytest.approx(2.0)
    assert per_doubling(16.0, 1.0, 400, 100) == pytest.approx(4.0)
    assert per_doubling(3.0, 3.0, 150, 100) == pytest.approx(1.0)


@pytest.mark.bench
@pytest.mark.parametrize("refined", [True, False], ids=["refined", "filter"])
def test_a_growing_floor(benchmark, tmp_path, refined):
    for blocks in BLOCKS:
        world = office_floor(blocks, np.random.default_rng(1))
        folder = tmp_path / str(blocks)
        folder.mkdir()
        write(simulate(world, np.random.default_rng(1)), folder)
    more = () if refined else ("--no-refine",)
    costs = {blocks: [] for blocks in BLOCKS}

    def once() -> None:
        for blocks in BLOCKS:
            folder = tmp_path / str(blocks)
            out = folder / "out"
            costs[blocks].append(
                hiermap("run", folder / LOG, "-o", out, "--force", "--quiet", *more)
            )

    benchmark.pedantic(once, rounds=ROUNDS)
    rows = []
    for blocks in BLOCKS:
        report = json.loads((tmp_path / str(blocks) / "out" / "report.json").read_text())
        row = {
            "blocks": blocks,
            "scans": report["input"]["scans"],
            "processor_seconds": min(cost.seconds for cost in costs[blocks]),
            "peak_megabytes": min(cost.peak_megabytes for cost in costs[blocks]),
            "stages_seconds": report["timing"],
        }
        for name in ("processor_seconds", "peak_megabytes"):
            if rows:
                last, scans = rows[-1], row["scans"]
                growth = per_doubling(row[name], last[name], scans, last["scans"])
                row[f"{name}_per_doubling"] = growth
        rows.append(row)
    worst = max(row.get(key, 0.0) for row in rows for key in row if key.endswith("per_doubling"))
    benchmark.extra_info |= {"floors": rows, "most": MOST, "worst": worst}
    assert [row["scans"] for row in rows] == sorted(row["scans"] for row in rows)
