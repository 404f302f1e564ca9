"""How much of a run has a true pose or relation near in time: none is an error, little a warning.

A figure of few poses looks like that of the whole run. It is so where the truth is that of another
log, its clock is another, or its stamps are not in seconds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.evaluation.relations import MAX_GAP_S as RELATION_GAP_S
from hiermap_cli.evaluation.trajectory import MAX_GAP_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.documents.relations import Relations

    Stamps = NDArray[np.int64]

SMALL = 0.5  # a smaller share of the poses is said
_SPARSE_S = 5.0  # a true pose stands for the run's poses this far from it, if there are no more
_WHAT_TO_DO = (
    "is it of the same log and clock, with stamps in seconds? The figures tell of nothing else "
    "of the run"
)


def no_overlap(name: str, run_ns: Stamps, true_ns: Stamps, gap_s: float) -> str:
    """Why a truth with stamps (T,), or of relations (2 M,), says nothing of a run (N,)."""
    return (
        f"{name}: no two stamps lie within {gap_s:g} s of the run's trajectory "
        f"({_spans(true_ns, run_ns)}); is it of the same log and clock, with stamps in seconds?"
    )


def trajectory_warning(name: str, run_ns: Stamps, true_ns: Stamps) -> str | None:
    """That only a small share of the run's poses, or of the true ones in its time, pair up.

    run_ns (N,) and true_ns (T,) are stamps in order; at least one true pose has one of the run
    within `MAX_GAP_S`. A truth of fewer poses than the run's stands for what lies between them.
    """
    paired = true_ns[_gaps_s(true_ns, run_ns) <= MAX_GAP_S]
    every = float(np.median(np.diff(true_ns))) * 1e-9 if len(true_ns) > 1 else 0.0
    reach = max(MAX_GAP_S, min(every, _SPARSE_S))
    covered = int(np.count_nonzero(_gaps_s(run_ns, paired) <= reach))
    if covered < SMALL * len(run_ns):
        return (
            f"{name}: only {covered} of the run's {len(run_ns)} poses "
            f"({_percent(covered, len(run_ns))}) have a true pose near in time, and {len(paired)} "
            f"of {len(true_ns)} true poses are compared ({_spans(true_ns, run_ns)}): {_WHAT_TO_DO}"
        )
    within = int(np.count_nonzero((true_ns >= run_ns.min()) & (true_ns <= run_ns.max())))
    if len(paired) < SMALL * within:
        return (
            f"{name}: of the {within} true poses in the run's time only {len(paired)} "
            f"({_percent(len(paired), within)}) have a pose of the run within {MAX_GAP_S:g} s: "
            "is it of the same log and clock, and is the run's trajectory whole?"
        )
    return None


def relations_warning(name: str, run_ns: Stamps, relations: Relations) -> str | None:
    """That only a small share of the relations have both their stamps near a pose of the run."""
    first, second = (
        _gaps_s(stamps, run_ns) <= RELATION_GAP_S
        for stamps in (relations.stamps1_ns, relations.stamps2_ns)
    )
    used, total = int(np.count_nonzero(first & second)), len(relations.poses)
    if used >= SMALL * total:
        return None
    stamps = np.concatenate((relations.stamps1_ns, relations.stamps2_ns))
    return (
        f"{name}: only {used} of the {total} relations ({_percent(used, total)}) lie in the run's "
        f"time ({_spans(stamps, run_ns)}): {_WHAT_TO_DO}"
    )


def _gaps_s(at_ns: Stamps, stamps_ns: Stamps) -> NDArray[np.float64]:
    """Seconds (Q,) from each of (Q,) stamps to the nearest of (N,), in any order."""
    if len(stamps_ns) == 0:
        return np.full(len(at_ns), np.inf)
    stamps_ns = np.sort(stamps_ns)
    after = np.clip(np.searchsorted(stamps_ns, at_ns), 1, max(1, len(stamps_ns) - 1))
    after = np.minimum(after, len(stamps_ns) - 1)
    before = np.maximum(after - 1, 0)
    gaps = np.minimum(np.abs(at_ns - stamps_ns[before]), np.abs(stamps_ns[after] - at_ns))
    return np.asarray(gaps * 1e-9)


def _percent(part: int, whole: int) -> str:
    share = 100.0 * part / whole
    return f"{share:.0f} %" if share >= 1.0 else f"{share:.2g} %"


def _spans(true_ns: Stamps, run_ns: Stamps) -> str:
    first, second = (
        f"{stamps.min() / 1e9:.3f} to {stamps.max() / 1e9:.3f} s" for stamps in (true_ns, run_ns)
    )
    return f"{first} against the run's {second}"
