"""`make sensitivity`: what the map is like with every threshold moved by a fifth.

    python tests/real/sensitivity.py [LOG...] [--only WORD] [--at-once 2] [-o FILE] [--of COMMIT]

Each threshold of association, relocation, recognition of areas, doors, loops and refinement is
moved by -20 % and by +20 %, all others left alone, on two real logs and a simulated floor. Runs
are kept (`variants.py`): a table that was interrupted goes on where it was.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from hiermap_cli.config import Config
from hiermap_cli.estimation.association import chi_square, chi_square_tail

sys.path.insert(0, str(Path(__file__).parent))
from runs import ROOT
from variants import Figures, Variant, folder, kept_figures, make_all, present

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

PAGE = ROOT / "docs" / "sensitivity.md"
SECTIONS = ("association", "areas", "loops", "doors", "relocation", "refine")
LOGS = ("fr079", "aces", "office")
FACTORS = (0.8, 1.2)
WORSE, OFF = 2.0, 0.05  # times, and metres, beyond which a map is lost
LEAST = 0.75  # of the areas, doors and edges that the default finds


class Threshold(NamedTuple):
    """A number of the configuration: its section, its key, its default."""

    section: str
    key: str
    value: Any

    def __str__(self) -> str:
        return f"{self.section}.{self.key}"


class Outcome(NamedTuple):
    """What is judged of a map: metres of error, areas and doors that are true ones, edges' share.

    fault: why there is none.
    """

    error: float
    areas: int | None = None
    doors: int | None = None
    edges: float | None = None
    fault: str | None = None


def thresholds(config: Config) -> list[Threshold]:
    """Every number of the sections: integers, reals and tuples of them, but no switches."""
    found = []
    for section in SECTIONS:
        for key in type(getattr(config, section)).model_fields:
            value = getattr(getattr(config, section), key)
            numbers = value if isinstance(value, tuple) else (value,)
            if all(isinstance(n, int | float) and not isinstance(n, bool) for n in numbers):
                found.append(Threshold(section, key, value))
    return found


def moved(threshold: Threshold, factor: float) -> Config | None:
    """The default configuration with one threshold moved; None where there is nowhere to go.

    A whole number goes at least to the next one. What would leave its range stops at its bound.
    A gate that is a probability is moved as what it stands for, a chi-square (of a segment's two
    degrees).
    """
    default = Config()
    section = getattr(default, threshold.section)
    info = type(section).model_fields[threshold.key]
    value = _moved(threshold, info, factor)
    if value == threshold.value:
        return None
    changed = {**section.model_dump(), threshold.key: value}
    told = {**default.model_dump(), threshold.section: changed}
    return Config.model_validate(told)


def _moved(threshold: Threshold, info: FieldInfo, factor: float) -> Any:
    value = threshold.value
    if isinstance(value, tuple):
        return tuple(round(factor * one, 9) for one in value)
    if threshold.section == "association" and threshold.key == "gate":
        return 1.0 - chi_square_tail(factor * chi_square(value, 2), 2)
    low, high = _bound(info, "ge", -math.inf), _bound(info, "le", math.inf)
    if isinstance(value, int):
        step = max(round(abs(factor - 1.0) * value), 1)
        return int(min(max(value + (step if factor > 1.0 else -step), low), high))
    return min(max(round(factor * value, 9), low), high)


def _bound(info: FieldInfo, name: str, default: float) -> float:
    """The bound `ge` or `le` of a field; the last one said holds."""
    said = [getattr(m, name) for m in info.metadata if getattr(m, name, None) is not None]
    return float(said[-1]) if said else default


def outcome(figures: Figures) -> Outcome:
    """The judgement of a run: relations where there are any, otherwise the ATE."""
    if "fault" in figures:
        return Outcome(math.inf, fault=figures["fault"])
    if "relations" in figures:
        error = figures["relations"]["final"]["trans_mean"]
    else:
        error = figures["ate_rmse"]["final"]
    matched = [figures.get(f"{kind}_matched") for kind in ("areas", "doors")]
    judged = figures.get("map", {})
    edges = [judged[f"topology_{p}"] for p in ("precision", "recall") if f"topology_{p}" in judged]
    areas, doors = (None if one is None else int(one["matched"]) for one in matched)
    return Outcome(math.inf if error is None else error, areas, doors, min(edges, default=None))


def is_lost(here: Outcome, default: Outcome) -> bool:
    """Whether the map is lost: see the page."""
    if here.fault is not None or not here.error <= WORSE * default.error + OFF:
        return True
    for now, before in zip(here[1:4], default[1:4], strict=True):
        if before is not None and (now is None or now < LEAST * before):
            return True
    return False


def cell(here: Outcome | None, default: Outcome) -> str:
    """`44.1 14 15`: millimetres, areas, doors; what is as by default is not told again."""
    if here is None:
        return ""
    if here.fault is not None:
        return "**failed**"
    text = f"{1e3 * here.error:.1f}"
    if (text, *here[1:3]) == (f"{1e3 * default.error:.1f}", *default[1:3]):
        text = "="
    else:
        text = " ".join([text, *(str(n) for n in here[1:3] if n is not None)])
    return f"**lost** {text}" if is_lost(here, default) else text


Rows = dict[tuple[Threshold, float, str], Outcome | None]


def page(defaults: dict[str, Outcome], rows: Rows, asked: int, commit: str) -> str:
    """The page of the docs. rows: by threshold, factor and log. asked: number of runs in all."""
    logs = list(defaults)
    made = {key: one for key, one in rows.items() if one is not None}
    lines = [HEAD.rstrip(), ""]
    if len(made) < asked:
        lines += [f"**Partial**: {len(made)} of {asked} runs were made, others are not shown.", ""]
        shown = {key[0] for key in made}
        rows = {key: one for key, one in rows.items() if key[0] in shown}
    lines += [
        f"The program was that of {commit}.",
        "",
        "| log | measured | default | median | worst | by | lost |",
        "|---|---|---|---|---|---|---|",
    ]
    for log in logs:
        here = {key: one for key, one in made.items() if key[2] == log}
        lost = sum(is_lost(one, defaults[log]) for one in here.values())
        errors = sorted((one.error, f"{key[0]} {_percent(key[1])}") for key, one in here.items())
        if not errors:
            continue
        middle, worst = errors[len(errors) // 2], errors[-1]
        lines.append(
            f"| {log} | {MEASURED.get(log, 'ATE')} | {_told(defaults[log])}"
            f" | {1e3 * middle[0]:.1f} | {1e3 * worst[0]:.1f} | {worst[1]}"
            f" | {lost} of {len(here)} |"
        )
    for section in dict.fromkeys(key[0].section for key in rows):
        head = [f"{log} {_percent(factor)}" for log in logs for factor in FACTORS]
        lines += ["", f"## {section}", "", f"| key | default | {' | '.join(head)} |"]
        lines.append("|---" * (2 + len(head)) + "|")
        for t in dict.fromkeys(key[0] for key in rows if key[0].section == section):
            cells = [
                cell(rows.get((t, factor, log)), defaults[log]) if (t, factor, log) in rows else "-"
                for log in logs
                for factor in FACTORS
            ]
            lines.append(f"| `{t.key}` | {_plain(t.value)} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


MEASURED = {"fr079": "mean of all relations", "aces": "ATE", "office": "ATE"}
HEAD = f"""# What every threshold is worth

One set of values serves all logs. That it does not hang on a thread shows when each threshold of
association, relocation, the recognition of areas, doors, loops and refinement is moved by -20 %
and by +20 %, one at a time, all others left as they are. Written by `make sensitivity`.

A map is **lost** when its error is more than {WORSE:g} times that of the defaults plus
{100 * OFF:g} cm, when it has fewer than {100 * LEAST:g} % of the areas or doors that the defaults
get right, or of the area graph's precision or recall, or when the run fails. Noise figures of
laser and odometry are no thresholds. A whole number is moved to the next one at least; a share
stops at its bound, and where it stands there already the table has a dash; a gate that is a
probability is moved as the chi-square it stands for. fr079 and aces are real logs, office is the
simulated floor of `datasets/` with a ring corridor.

Errors are in millimetres, after the refinement: of fr079 the mean translational error of all 1685
relations, of the others the root mean square error of the trajectory. The numbers after them are
areas (IoU of 0.5 and more) and doors found of those that are there; `=` is as by default.
"""


def _percent(factor: float) -> str:
    return f"{100.0 * (factor - 1.0):+.0f} %"


def _plain(value: Any) -> str:
    return ", ".join(f"{n:g}" for n in value) if isinstance(value, tuple) else f"{value:g}"


def _told(one: Outcome) -> str:
    counts = ((one.areas, "areas"), (one.doors, "doors"))
    found = "".join(f", {n} {what}" for n, what in counts if n is not None)
    return f"{1e3 * one.error:.1f}{found}"


def tell(number: int, of: int, log: str, what: str, one: Outcome) -> None:
    """A line of progress."""
    told = one.fault or _told(one)
    sys.stderr.write(f"[{number}/{of}] {log} {what}: {told}\n")
    sys.stderr.flush()


def main() -> int:
    parser = argparse.ArgumentParser(description="moves every threshold by a fifth")
    parser.add_argument("logs", nargs="*", default=LOGS, help=", ".join(LOGS))
    parser.add_argument("--only", default="", help="thresholds whose name has this in it")
    parser.add_argument("--at-once", type=int, default=2)
    parser.add_argument("--of", default="", help="the commit, as the page names it")
    parser.add_argument("--kept", action="store_true", help="make nothing, only write the page")
    parser.add_argument("-o", "--output", type=Path, default=PAGE)
    given = parser.parse_args()
    logs = present(given.logs)
    asked: dict[tuple[Threshold, float, str], Variant] = {}
    for threshold in thresholds(Config()):
        for factor in FACTORS:
            config = moved(threshold, factor) if given.only in str(threshold) else None
            if config is not None:
                asked |= {(threshold, factor, log): Variant(log, config) for log in logs}
    names = {id(one): f"{key[0]} {_percent(key[1])}" for key, one in asked.items()}
    defaults = [Variant(log, Config()) for log in logs]
    every = [*defaults, *asked.values()]
    if given.kept:
        figures = [kept_figures(one, folder()) for one in every]
    else:
        figures = list(
            make_all(
                every,
                lambda n, one, of: tell(
                    n, len(every), one.log, names.get(id(one), "default"), outcome(of)
                ),
                given.at_once,
            )
        )
    outcomes = [None if one is None else outcome(one) for one in figures]
    by_default = {
        log: one for log, one in zip(logs, outcomes[: len(logs)], strict=True) if one is not None
    }
    rows = {
        key: one
        for key, one in zip(asked, outcomes[len(logs) :], strict=True)
        if key[2] in by_default
    }
    commit = given.of or "this checkout"
    given.output.write_text(page(by_default, rows, len(asked), commit))
    return 0


if __name__ == "__main__":
    sys.exit(main())
