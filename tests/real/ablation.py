"""`make ablation`: what each part of the method is worth.

    python tests/real/ablation.py [--seeds 10] [--only WORD] [--at-once 2] [-o FILE] [--of COMMIT]

Each part is left out, all others left as they are, on two real logs and on the ring of the
paper's figure 1 over several seeds. Runs are kept (`variants.py`).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hiermap_cli.config import Config

sys.path.insert(0, str(Path(__file__).parent))
from runs import ROOT
from variants import Figures, Variant, make_all, present

if TYPE_CHECKING:
    from collections.abc import Sequence

PAGE = ROOT / "docs" / "ablation.md"
RING = "ring"
LOGS = ("fr079", "aces", RING)


class Part(NamedTuple):
    """What is left out: a name for the table, and the configuration without it."""

    name: str
    told: dict[str, Any]

    def config(self) -> Config:
        """Of the runs without it."""
        return Config.model_validate(self.told)


KNOWN = dict.fromkeys(
    ("prior_scale", "prior_rotation_scale", "prior_curvature", "prior_laser_x"), 0.0
)
PARTS = (
    Part("nothing: the defaults", {}),
    Part("landmarks only", {"filter": {"features": "landmarks"}}),
    Part("walls without their ends", {"filter": {"features": "walls"}}),
    Part("no relocation-fusion", {"update": "ekf"}),
    Part("additive coordinates", {"coordinates": "additive"}),
    Part("plain EKF: both", {"update": "ekf", "coordinates": "additive"}),
    Part("no joint compatibility", {"association": {"joint": False}}),
    Part("no calibration of odometry", {"odometry": KNOWN}),
    Part("no noise from the log", {"noise": {"estimate": False}}),
    Part("no loops", {"loops": {"enabled": False}}),
    Part("no refinement, no loops", {"refine": {"enabled": False}}),
)

HEAD = """# What each part is worth

Each line leaves one part out, all others as they are. Written by `make ablation`.

Figures are `filter / in the end`. fr079 is a real office floor: metres of mean translational error
over all 1685 relations, and how many of its 16 areas and 16 doors are found. aces is four real
corridor loops with scans a metre apart: metres of root mean square error of the trajectory. The
ring is the world of the paper's figure 1 (`datasets/ring.yaml`), re-entered through the other
door, over {seeds} seeds: millimetres of root mean square error in the mean and at worst, the mean
`nees_robot`, which is 1 where the covariance tells the truth and more where it is too small, and
in how many of the runs exactly the areas and doors that are there were found.

- *landmarks only*: only segments that show an end or a corner count, each of which tells a whole
  pose (`filter.features: landmarks`). No wall or corridor holds the robot across itself.
- *walls without their ends*: lines alone (`filter.features: walls`).
- *no relocation-fusion*, *additive coordinates*, *plain EKF*: `update: ekf`,
  `coordinates: additive`, and both.
- *no joint compatibility*: each segment goes to its own best wall (`association.joint: false`).
- *no calibration of odometry*: its constant faults count as zero (`odometry.prior_*: 0`).
- *no noise from the log*: the noise figures are those of the configuration (`noise.estimate`).
- *no loops*: `loops.enabled: false`; doors that are known again still join what they join.
- *no refinement, no loops*: the filter alone (`--no-refine`).
"""


def row(part: Part, figures: dict[str, list[Figures]]) -> str:
    """The line of one part. figures: of each log, a run a seed."""
    cells = [part.name]
    for log, runs in figures.items():
        cells += _cells(log, runs)
    return "| " + " | ".join(cells) + " |"


def columns(log: str) -> list[str]:
    """The heads of a log's columns."""
    if log == RING:
        return ["ring mm", "ring worst mm", "ring NEES", "ring areas, doors"]
    return ["fr079 relations", "fr079 areas, doors"] if log == "fr079" else [f"{log} ATE"]


def _cells(log: str, runs: list[Figures]) -> list[str]:
    """What stands in a log's columns."""
    failed = sum("fault" in run for run in runs)
    if failed:
        return [f"failed {failed} of {len(runs)}", *[""] * (len(columns(log)) - 1)]
    if log == RING:
        return _ring(runs)
    (run,) = runs
    if "relations" not in run:
        return [_both([run["ate_rmse"][track] for track in ("filter", "final")], 3)]
    relations = [run["relations"][track]["trans_mean"] for track in ("filter", "final")]
    found = [str(run[f"{kind}_matched"]["matched"]) for kind in ("areas", "doors")]
    return [_both(relations, 3), ", ".join(found)]


def _ring(runs: list[Figures]) -> list[str]:
    errors = 1e3 * np.array([[run["ate_rmse"][t] for t in ("filter", "final")] for run in runs])
    nees = np.array([[run["nees_robot_filter"], run["nees_robot"]] for run in runs])
    whole = sum(_is_whole(run) for run in runs)
    return [
        _both(errors.mean(axis=0), 1),
        _both(errors.max(axis=0), 1),
        _both(nees.mean(axis=0), 2),
        f"right in {whole} of {len(runs)}",
    ]


def _is_whole(run: Figures) -> bool:
    """Whether all areas and doors of a world were found, and none that are not there."""
    return all(
        run[f"{kind}_matched"]["matched"] == run[kind] == run["visited"][kind]
        for kind in ("areas", "doors")
    )


def _both(two: Sequence[float], digits: int) -> str:
    by_filter, final = two
    return f"{by_filter:.{digits}f} / {final:.{digits}f}"


def page(rows: list[str], logs: list[str], seeds: int, commit: str) -> str:
    """The page of the docs."""
    head = ["left out", *(column for log in logs for column in columns(log))]
    lines = [
        HEAD.format(seeds=seeds),
        f"The program was that of {commit}.",
        "",
        "| " + " | ".join(head) + " |",
        "|---" * len(head) + "|",
        *rows,
    ]
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description="leaves out one part after the other")
    parser.add_argument("logs", nargs="*", default=LOGS, help=", ".join(LOGS))
    parser.add_argument("--seeds", type=int, default=10, help="of the ring")
    parser.add_argument("--only", default="", help="parts whose name has this in it")
    parser.add_argument("--at-once", type=int, default=2)
    parser.add_argument("--of", default="this checkout", help="the commit, as the page names it")
    parser.add_argument("-o", "--output", type=Path, default=PAGE)
    given = parser.parse_args()
    logs = present(given.logs)
    parts = [part for part in PARTS if given.only in part.name]
    asked = {
        (part.name, log): [
            Variant(log, part.config(), seed) for seed in range(given.seeds if log == RING else 1)
        ]
        for log in logs
        for part in parts
    }
    names = {id(one): name for (name, _), variants in asked.items() for one in variants}
    every = sorted((v for some in asked.values() for v in some), key=lambda v: (v.log, v.seed))

    def tell(number: int, one: Variant, figures: Figures) -> None:
        told = figures.get("fault") or figures["ate_rmse"]
        sys.stderr.write(f"[{number}/{len(every)}] {one.log} {one.seed} {names[id(one)]}: {told}\n")
        sys.stderr.flush()

    made = dict(zip(map(id, every), make_all(every, tell, given.at_once), strict=True))
    rows = [
        row(part, {log: [made[id(one)] for one in asked[part.name, log]] for log in logs})
        for part in parts
    ]
    given.output.write_text(page(rows, logs, given.seeds, given.of))
    return 0


if __name__ == "__main__":
    sys.exit(main())
