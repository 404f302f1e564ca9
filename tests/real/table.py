"""`make real`: runs every real log and every world, and prints one table.

    python tests/real/table.py [NAME...] [--config FILE] [--save DIR] [--json]

Where a column has three figures they are of raw odometry / the filter / the final trajectory.
Trajectories are in metres against slam_reference.tum (no truth, good to some 5 cm) or, for the
worlds, the truth; relations in metres and degrees.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

RUNS = Path(__file__).with_name("runs.py")
TRACKS = ("odometry", "filter", "final")
AT_ONCE = 2  # more would disturb each other's processor time
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def names_here() -> list[str]:
    """The runs that can be made, in the table's order."""
    sys.path.insert(0, str(RUNS.parent))
    from runs import names

    return names()


def run(
    name: str, config: Path | None = None, save: Path | None = None, limit: float = 900.0
) -> dict[str, Any]:
    """The figures of one run, or its fault."""
    command = [sys.executable, str(RUNS), name]
    for option, value in (("--config", config), ("--save", save)):
        if value is not None:
            command += [option, str(value)]
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=limit,
            env={**os.environ, **ONE_THREAD},
            check=False,
        )
    except subprocess.TimeoutExpired:
        return {"name": name, "fault": f"not done after {limit:g} s"}
    if done.returncode != 0:
        said = done.stderr.strip().splitlines()
        return {"name": name, "fault": said[-1] if said else f"status {done.returncode}"}
    figures: dict[str, Any] = json.loads(done.stdout)
    return figures


def cells(figures: dict[str, Any]) -> dict[str, str]:
    """One row of the table."""
    own, judged = figures["own"], figures.get("map", {})
    landmarks = " ".join(f"{_short(kind)}{n}" for kind, n in figures["landmarks"].items())
    areas, doors = figures.get("areas_matched"), figures.get("doors_matched")
    matched, used = own.get("matches"), own.get("scans_processed")
    return {
        "log": figures["name"],
        "scans": str(figures["scans"]),
        "used": _number(used, 0),
        "matched": _number(matched, 0),
        "failed": _number(own.get("matching_failures"), 0),
        "ms/scan": f"{figures['milliseconds_a_scan']:.2f}",
        "MB": f"{figures['peak_megabytes']:.0f}",
        "areas": str(figures["areas"]),
        "doors": str(figures["doors"]),
        "landmarks": landmarks or "-",
        "ATE": _three(figures.get("ate_rmse")),
        "rel 10s": _three(figures.get("relations_10s"), "trans_mean", 4),
        "rel 10s deg": _three(figures.get("relations_10s"), "rot_mean_deg", 2),
        "rel all": _three(figures.get("relations"), "trans_mean", 3),
        "rel all deg": _three(figures.get("relations"), "rot_mean_deg", 2),
        "areas IoU>.5": "-" if not areas else f"{areas['matched']}/{areas['asked']}",
        "F1": "-" if not areas else f"{areas['f1']:.2f}",
        "doors hit": "-" if not doors else f"{doors['matched']}/{doors['asked']}",
        "corners p/r": _pair(judged, "corner_precision", "corner_recall"),
        "wall rmse": _number(judged.get("wall_rmse"), 3),
        "sigma": f"{figures['sigma_median']:.3f}",
        "NIS": _number(own.get("nis_mean"), 2),
        "NEES r": _number(figures.get("nees_robot"), 2),
        "NEES l": _number(judged.get("nees_landmarks"), 2),
    }


def _short(kind: str) -> str:
    """Initials of a landmark kind: corner_concave is cc, wall is w."""
    special = {"corner_concave": "cv", "corner_convex": "cx", "corridor": "co", "crossing": "cr"}
    return special.get(kind, kind[:2]) + ":"


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _pair(figures: dict[str, float], first: str, second: str) -> str:
    if first not in figures and second not in figures:
        return "-"
    return f"{_number(figures.get(first), 2)}/{_number(figures.get(second), 2)}"


def _three(figures: dict[str, Any] | None, key: str | None = None, digits: int = 3) -> str:
    """Odometry / filter / final."""
    if figures is None:
        return "-"
    values = [figures[track] if key is None else figures[track][key] for track in TRACKS]
    return "/".join("-" if value is None else f"{value:.{digits}f}" for value in values)


def table(rows: list[dict[str, Any]]) -> str:
    """All rows under one head; faults below it."""
    filled = [cells(figures) for figures in rows if "fault" not in figures]
    lines = []
    if filled:
        widths = {key: max(len(key), *(len(row[key]) for row in filled)) for key in filled[0]}
        lines.append("  ".join(key.ljust(width) for key, width in widths.items()).rstrip())
        lines += [
            "  ".join(row[key].ljust(width) for key, width in widths.items()).rstrip()
            for row in filled
        ]
    lines += [f"{row['name']}: FAILED: {row['fault']}" for row in rows if "fault" in row]
    return "\n".join(lines)


def _is_asked(name: str, asked: list[str], here: list[str]) -> bool:
    """By its name, or by the beginning of it where no run has exactly that name."""
    return name in asked or any(name.startswith(word) for word in asked if word not in here)


def main() -> int:
    parser = argparse.ArgumentParser(description="runs all logs and worlds, prints one table")
    parser.add_argument("names", nargs="*", help="only these, by name or beginning of it")
    parser.add_argument("--config", type=Path)
    parser.add_argument("--json", action="store_true", help="all figures as JSON")
    parser.add_argument("--save", type=Path, help="folder for model and trajectories of each")
    parser.add_argument("--limit", type=float, default=900.0, help="seconds for one run")
    given = parser.parse_args()
    here = names_here()
    chosen = [name for name in here if not given.names or _is_asked(name, given.names, here)]
    if not chosen:
        sys.stderr.write("nothing to run: there are " + (", ".join(here) or "no logs") + "\n")
        return 0 if not given.names else 2
    with ThreadPoolExecutor(AT_ONCE) as pool:
        rows = list(pool.map(lambda name: run(name, given.config, given.save, given.limit), chosen))
    sys.stdout.write((json.dumps(rows, indent=1) if given.json else table(rows)) + "\n")
    return 1 if any("fault" in row for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
