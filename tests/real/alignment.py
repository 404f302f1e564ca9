"""Alignment on the maps alone: how plain the best place is, for every run on every reference.

    python tests/real/alignment.py --run DIR... --reference FILE...

prints whether it is taken, what the next best place leaves unexplained over what the best does, and
the share of walls that stand where the reference is bare. The limits in `evaluation/alignment.py`
and the table in docs/evaluation.md come from here.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from hiermap_cli.batch.evaluate_run import YAML, read_run
from hiermap_cli.documents.occupancy import read_map_server
from hiermap_cli.documents.reference import read_reference
from hiermap_cli.evaluation.alignment import align_by_maps
from hiermap_cli.evaluation.evidence import (
    Raster,
    model_points,
    raster_of_grid,
    raster_of_reference,
)
from hiermap_cli.evaluation.placed import place


def raster_of(path: Path) -> Raster | None:
    """The raster of a reference of either kind."""
    if path.suffix.lower() in YAML:
        return raster_of_grid(read_map_server(path))
    return raster_of_reference(read_reference(path))


def main() -> int:
    parser = argparse.ArgumentParser(description="every run against every reference")
    parser.add_argument("--run", type=Path, nargs="+", required=True)
    parser.add_argument("--reference", type=Path, nargs="+", required=True)
    given = parser.parse_args()
    for reference in given.reference:
        raster = raster_of(reference)
        for folder in given.run:
            run = read_run(folder)
            assert run.model is not None
            track = run.trajectory.poses[:: max(1, len(run.trajectory.poses) // 500), :2]
            found = align_by_maps(model_points(place(run.model, np.zeros(3)), track), raster)
            line = f"{reference.stem:16} {folder.name:12} {'taken' if not found.reason else '-':6}"
            if found.best is not None:
                best = found.best
                next_best = found.second.surprise / best.surprise if found.second else np.inf
                line += f" next/best {next_best:6.2f}  bare {best.against:6.1%}"
                line += f"  walls {best.walls:6.1%}  ground {best.ground:6.1%}"
                line += f"  at {np.round(best.R_t_g, 2).tolist()}"
            sys.stdout.write(line + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
