"""The loops alone, on all that the filter makes of the real logs, as they are and made poorer.

    python tests/real/loops.py [NAME...] [--set FIELD=VALUE ...] [--about]

The filter's key scans are made once and kept in out/loops, by the sources that make them, so that
a change of `mapping/loops` is judged on 32 runs in half a minute. A name is that of a log, or of a
log made poorer (`csail-thin`). Printed as a table of Markdown: loops closed, held back and refused,
those closed that the reference gives otherwise by more than 1 m, and the errors of the key poses
before and after. `--set` is of the section `loops`; `--about` tells of every loop that was not
closed why.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import pickle
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.config import Config
from hiermap_cli.documents.tum import read_tum
from hiermap_cli.evaluation.trajectory import ate
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.filtering import run_filter
from hiermap_cli.mapping.levels import compose_levels
from hiermap_cli.mapping.loops.closing import LoopResult, close_loops

sys.path.insert(0, str(Path(__file__).parent))
from poorer import ONE_THREAD, WAYS
from runs import DATA, REAL_LOGS, ROOT, Watched, opened
from variants import present

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.estimation.noise import NoiseScale
    from hiermap_cli.mapping.keyscans import KeyScans

LOGS = ("fr079", "fr079_unsigned", "csail", "aces")
WRONG = 1.0
GAP_NS = 2_000_000_000  # between poses of the reference, at most
HEAD = ("log", "key scans", "closed, held back, refused", "wrong", "ATE before, after")
ABOUT = ("overlap", "cross", "pairs", "crossing", "second", "chi2", "witnesses")


class Filtered(NamedTuple):
    """What loops are looked for in; poses (K, 3) are the filter's at the key scans."""

    keyscans: KeyScans
    poses: NDArray[np.float64]
    noise: NoiseScale


def sources() -> str:
    """A digest of all that the filter's key scans depend on, and of more."""
    digest = hashlib.sha256()
    for path in sorted((ROOT / "hiermap_cli").rglob("*.py")):
        if "loops" not in path.relative_to(ROOT).parts:
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def filtered(name: str) -> Filtered:
    """The filter's key scans of a log, or of a log made poorer; kept."""
    path = ROOT / "out" / "loops" / sources() / f"{name}.pickle"
    if not path.exists():
        log, _, way = name.partition("-")
        config = Config()
        blocks = WAYS[way or "plain"](opened(log, config).watched, np.random.default_rng(0))
        mapper, _ = run_filter(Watched(blocks), config)
        poses = compose_levels(mapper).trajectory.poses[np.array(mapper.trail.key_at)]
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        part.write_bytes(pickle.dumps(Filtered(mapper.keyscans.taken(), poses, mapper.noise)))
        part.rename(path)
    found: Filtered = pickle.loads(path.read_bytes())
    return found


def row(name: str, fields: dict[str, float], *, about: bool) -> str:
    """The loops of one run as a row of the table; metres."""
    keyscans, poses, noise = filtered(name)
    config = Config()
    config = config.model_copy(update={"loops": config.loops.model_copy(update=fields)})
    result = close_loops(keyscans, poses, config, noise)
    kinds = Counter(event.kind for event in result.events)
    told = [str(kinds[f"loop_{kind}"]) for kind in ("closed", "held_back", "refused")]
    truth = read_tum(DATA / (REAL_LOGS[name.partition("-")[0]].truth or ""))
    errors = [ate(keyscans.stamps_ns, p, *truth).rmse for p in (poses, result.poses)]
    cells = [
        name, str(len(poses)), ", ".join(told), wrong(keyscans, result, *truth),
        f"{errors[0]:.3f}, {errors[1]:.3f}",
    ]  # fmt: skip
    lines = [f"| {' | '.join(cells)} |"]
    for event in result.events if about else ():
        if event.kind != "loop_closed":
            figures = ", ".join(f"{key} {event.details[key]:.3g}" for key in ABOUT)
            when = f"{event.details['to']:.1f} s and {event.stamp_ns * 1e-9:.1f} s"
            lines.append(f"  {event.kind} {when}: {figures}")
    return "\n".join(lines)


def wrong(
    keyscans: KeyScans, result: LoopResult, stamps_ns: NDArray[np.int64], poses: NDArray[np.float64]
) -> str:
    """Of the loops closed those that the reference gives otherwise, of those that it knows of.

    By its positions alone: where it has a pose a second the heading in a turn is nobody's.
    """
    keys = np.array([[loop.key_i, loop.key_j] for loop in result.edges], dtype=int).reshape(-1, 2)
    at = keyscans.stamps_ns[keys]
    after = np.clip(np.searchsorted(stamps_ns, at), 1, len(stamps_ns) - 1)
    gap = stamps_ns[after] - stamps_ns[after - 1]
    share = (at - stamps_ns[after - 1]) / np.maximum(gap, 1)
    known = ((share >= 0.0) & (share <= 1.0) & (gap < GAP_NS)).all(axis=1)
    true = se2.interpolate(poses[after - 1], poses[after], np.clip(share, 0.0, 1.0))
    aligned = ate(keyscans.stamps_ns, result.poses, stamps_ns, poses).alignment
    R_i_j = np.array([loop.R_i_j for loop in result.edges]).reshape(-1, 3)
    from_i = np.column_stack((true[:, 0, :2], aligned[2] + result.poses[keys[:, 0], 2]))
    off = se2.compose(from_i, R_i_j)[:, :2] - true[:, 1, :2]
    return f"{int((np.hypot(*off.T) > WRONG)[known].sum())} of {int(known.sum())}"


def main() -> int:
    parser = argparse.ArgumentParser(description="the loops alone, on what the filter made")
    parser.add_argument("names", nargs="*", default=[f"{x}-{way}" for x in LOGS for way in WAYS])
    parser.add_argument("--set", nargs="*", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--about", action="store_true", help="tell of the loops not closed")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    os.environ.update(ONE_THREAD)
    fields = {name: float(value) for name, value in (one.split("=") for one in given.set)}
    here = present(sorted({name.partition("-")[0] for name in given.names}))
    names = [name for name in given.names if name.partition("-")[0] in here]
    sys.stdout.write(f"| {' | '.join(HEAD)} |\n{'|---' * len(HEAD)}|\n")
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        for line in pool.map(partial(row, fields=fields, about=given.about), names):
            sys.stdout.write(line + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
