"""Whether the covariances may be trusted: every normalised mean with its band, and one sentence."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

from hiermap_cli.evaluation.bands import Band, band, independent_of_chain

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from hiermap_cli.evaluation.consistency import Nees

_RIGHT = (0.8, 1.25)
_MOST = 100.0  # a larger factor is no measurement any more
_ENOUGH = 3  # values of a group before it is called the worst


class Check(NamedTuple):
    """A mean of normalised squares a degree of freedom, which is one where covariances are true.

    name: as in eval.json's metrics; where: the part of it that this is, `area A3`, `kind door`, or
    nothing. band: where 95 of 100 honest runs would have it.
    """

    name: str
    where: str
    value: float
    n: int
    band: Band

    @property
    def factor(self) -> float:
        """How many times as large errors are as their deviations say."""
        return math.sqrt(self.value)

    @property
    def state(self) -> str:
        """`consistent`, `overconfident` or `cautious`.

        Over many values the band is so narrow that no model of noise stays in it: deviations that
        are right to some 12 percent are right.
        """
        if self.value > max(self.band.high, _RIGHT[1]):
            return "overconfident"
        return "cautious" if self.value < min(self.band.low, _RIGHT[0]) else "consistent"

    def document(self) -> dict[str, Any]:
        """As eval.json carries it."""
        return {
            "name": self.name,
            **({"where": self.where} if self.where else {}),
            "value": self.value,
            "n": self.n,
            "independent": self.band.independent,
            "band": [self.band.low, self.band.high],
            "state": self.state,
        }


def check(name: str, nees: Nees, degrees: int, where: str = "") -> Check | None:
    """A NEES with its band; None where it was not measured."""
    if nees.n == 0:
        return None
    independent = nees.n if math.isnan(nees.independent) else nees.independent
    return Check(name, where, nees.mean, nees.n, band(degrees, independent))


def innovation_checks(consistency: Mapping[str, Any]) -> list[Check]:
    """What report.json's `consistency` says: all innovations, by kind, by area, and loops.

    How many innovations are independent follows from their correlation of lag one.
    """
    out = []
    whole = consistency.get("innovations")
    parts = [("nis", "", whole)] if whole else []
    parts += [
        (f"nis_{one['kind']}", f"kind {one['kind']}", one) for one in consistency.get("kinds", ())
    ]
    parts += [("nis", f"area {one['area']}", one) for one in consistency.get("areas", ())]
    for name, where, one in parts:
        if one.get("nis") is None or not one["degrees"]:
            continue
        independent = independent_of_chain(one["degrees"], one["lag1"] or 0.0)
        out.append(Check(name, where, one["nis"], one["matches"], band(1.0, independent)))
    loops = consistency.get("loops", ())
    if loops:
        mean = sum(loop["nis"] for loop in loops) / len(loops)
        out.append(Check("loop_nis", "", mean, len(loops), band(3.0, len(loops))))
    return out


def verdict(errors: Sequence[Check], innovations: Sequence[Check], parts: Sequence[Check]) -> str:
    """One sentence for a person.

    Args:
        errors: of robot, landmarks and areas against what is true; the most telling first.
        innovations: of the run itself.
        parts: the same by area and by kind, to say where it is worst.
    """
    told = errors or innovations
    if not told:
        return ""
    # What is believed too much does harm; what is believed too little is only said after it.
    order = {"overconfident": 0, "cautious": 1, "consistent": 2}
    lead = min(told, key=lambda one: order[one.state])
    inside = f"{lead.band.low:.2f} to {lead.band.high:.2f} would be consistent"
    against = "" if errors else "; no truth was given, so that only the innovations tell"
    if lead.state == "consistent":
        names = ", ".join(f"{one.name} {one.value:.2f}" for one in told)
        return f"consistent: the covariances cover the errors ({names}){against}"
    worst = _worst(parts, over=lead.state == "overconfident")
    if lead.state == "overconfident":
        what = f"overconfident by a factor of {_times(lead.factor)}"
        means = "errors are that many times as large as the deviations say"
    else:
        what = f"too cautious by a factor of {_times(1.0 / max(lead.factor, 1e-9))}"
        means = "deviations are that many times as large as the errors"
    return f"{what}: {means} ({lead.name} {_short(lead.value)}; {inside}){worst}{against}"


def _times(factor: float) -> str:
    return f"{factor:.1f}" if factor <= _MOST else f"more than {_MOST:g}"


def _short(value: float) -> str:
    return f"{value:.2f}" if value < _MOST else f"{value:.3g}"


def _worst(parts: Sequence[Check], *, over: bool) -> str:
    """Where it is worst: the area and the kind of landmark farthest beyond their bands."""
    said = []
    for group, word in (("area ", "in "), ("kind ", "for ")):
        state = "overconfident" if over else "cautious"
        beyond = [
            one
            for one in parts
            if one.where.startswith(group) and one.n >= _ENOUGH and one.state == state
        ]
        if beyond:
            worst = max(beyond, key=lambda one: one.value if over else -one.value)
            said.append(f"{word}{worst.where} ({worst.name} {_short(worst.value)})")
    return f", worst {' and '.join(said)}" if said else ""
