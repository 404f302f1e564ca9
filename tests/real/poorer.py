"""The real logs made poorer: fewer scans or beams, more noise, wheels that slip.

    python tests/real/poorer.py [LOG...] [--ways half,thin,...]

Nothing was ever chosen by these logs: they stand for robots and sensors not seen before. Printed
as a table of Markdown are the errors of the filter and of the final map, as in `table.py`.
"""

from __future__ import annotations

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.config import Config
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.run import map_log

sys.path.insert(0, str(Path(__file__).parent))
from runs import Source, Watched, judged, opened
from variants import present

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from hiermap_cli.logs.records import ScanBlock

    Way = Callable[[Iterable[ScanBlock], np.random.Generator], Iterator[ScanBlock]]


def every(step: int) -> Way:
    """One scan in `step`."""

    def way(blocks: Iterable[ScanBlock], _: np.random.Generator) -> Iterator[ScanBlock]:
        for block in blocks:
            yield block.part(slice(None, None, step))

    return way


def thin(blocks: Iterable[ScanBlock], _: np.random.Generator) -> Iterator[ScanBlock]:
    """Every second beam."""
    for block in blocks:
        ranges = np.ascontiguousarray(block.ranges[:, ::2])
        laser = block.laser._replace(
            angle_increment=2.0 * block.laser.angle_increment, beams=ranges.shape[1]
        )
        yield replace(block, ranges=ranges, laser=laser)


def short(blocks: Iterable[ScanBlock], _: np.random.Generator) -> Iterator[ScanBlock]:
    """A laser that reaches 8 m."""
    for block in blocks:
        ranges = np.where(block.ranges > 8.0, np.float32(np.inf), block.ranges)
        yield replace(block, ranges=ranges, laser=block.laser._replace(range_max=8.0))


def noisy(blocks: Iterable[ScanBlock], rng: np.random.Generator) -> Iterator[ScanBlock]:
    """2 cm of noise on every range besides its own."""
    for block in blocks:
        noise = rng.normal(0.0, 0.02, block.ranges.shape).astype(np.float32)
        yield replace(block, ranges=block.ranges + noise)


def holes(blocks: Iterable[ScanBlock], rng: np.random.Generator) -> Iterator[ScanBlock]:
    """One range in ten says nothing."""
    for block in blocks:
        lost = rng.random(block.ranges.shape) < 0.1
        yield replace(block, ranges=np.where(lost, np.float32(np.nan), block.ranges))


def slipping(blocks: Iterable[ScanBlock], rng: np.random.Generator) -> Iterator[ScanBlock]:
    """Scale 1.04, scale of rotations 0.96, 0.03 rad a metre of curvature, and 5 % of noise."""
    before: np.ndarray | None = None
    told = np.zeros(3)
    for block in blocks:
        odometry = np.empty_like(block.odometry)
        for i, pose in enumerate(block.odometry):
            if before is None:
                told = pose.copy()
            else:
                step = se2.between(before, pose)
                far = abs(float(step[0]))
                spread = np.array([0.05 * far, 0.02 * far, 0.05 * abs(step[2]) + 0.02 * far])
                step = step * (1.04, 1.0, 0.96) + (0.0, 0.0, 0.03 * far)
                told = se2.compose(told, step + spread * rng.normal(size=3))
            before, odometry[i] = pose, told
        yield replace(block, odometry=odometry)


WAYS: dict[str, Way] = {
    "plain": every(1),
    "half": every(2),
    "third": every(3),
    "thin": thin,
    "short": short,
    "noisy": noisy,
    "holes": holes,
    "slipping": slipping,
}


ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
HEAD = ("log", "made poorer", "ATE filter, final", "relations filter, final", "areas", "doors")


def row(log: str, way: str) -> str:
    """One run as a row of the table; metres."""
    config = Config()
    source = opened(log, config)
    watched = Watched(WAYS[way](source.watched, np.random.default_rng(0)))
    figures = judged(Source(log, watched), map_log(watched, config))
    ate, relations = figures["ate_rmse"], figures.get("relations")
    cells = [log, way, f"{ate['filter']:.3f}, {ate['final']:.3f}", ""]
    if relations:
        mean = {name: relations[name]["trans_mean"] for name in ("filter", "final")}
        cells[-1] = f"{mean['filter']:.4f}, {mean['final']:.4f}"
    return "| " + " | ".join([*cells, str(figures["areas"]), str(figures["doors"])]) + " |"


def main() -> int:
    parser = argparse.ArgumentParser(description="the real logs made poorer")
    parser.add_argument("logs", nargs="*", default=["fr079", "fr079_unsigned", "csail", "aces"])
    parser.add_argument("--ways", default=",".join(WAYS), help=", ".join(WAYS))
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    os.environ.update(ONE_THREAD)
    sys.stdout.write(f"| {' | '.join(HEAD)} |\n{'|---' * len(HEAD)}|\n")
    runs = list(product(present(given.logs), given.ways.split(",")))
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        for line in pool.map(row, *zip(*runs, strict=True)):
            sys.stdout.write(line + "\n")
            sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
