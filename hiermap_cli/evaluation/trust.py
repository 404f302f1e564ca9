"""All that is known of whether the covariances may be trusted, by area and by kind."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hiermap_cli.evaluation.consistency import Nees
from hiermap_cli.evaluation.verdict import Check, check, innovation_checks, verdict

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from hiermap_cli.mapping.model import HierarchicalModel, Trajectory

    Array = NDArray[np.float64]

_ENTRIES = ("area_entered", "area_reentered", "area_recognised")
_DEGREES = {"nees_robot": 3, "nees_landmarks": 2, "nees_areas": 3}


class Trusted(NamedTuple):
    """Checks of errors and of innovations, each also by area and by kind, and the sentence."""

    errors: tuple[Check, ...]
    innovations: tuple[Check, ...]
    parts: tuple[Check, ...]
    sentence: str

    def document(self) -> list[dict[str, Any]]:
        """The key `consistency` of eval.json."""
        return [one.document() for one in (*self.errors, *self.innovations, *self.parts)]


def trusted(
    trajectory: Trajectory,
    model: HierarchicalModel | None,
    nees: Mapping[str, Nees],
    consistency: Mapping[str, Any],
    events: Sequence[Mapping[str, Any]],
) -> Trusted:
    """What the errors, and the run's own innovations, say.

    Args:
        trajectory: of the run.
        model: of the run.
        nees: by metric, what was measured.
        consistency: of report.json.
        events: of report.json, which tell in which area the robot was.
    """
    whole = [check(name, one, _DEGREES[name]) for name, one in nees.items()]
    errors = tuple(one for one in whole if one is not None)
    told = innovation_checks(consistency)
    innovations = tuple(one for one in told if not one.where)
    parts: list[Check] = []
    if "nees_robot" in nees:
        areas = _areas_by_time(trajectory, events)
        parts += _groups("nees_robot", nees["nees_robot"].values, areas, "area ")
    if "nees_landmarks" in nees and model is not None:
        homes = {landmark.id: landmark.area for landmark in model.landmarks}
        kinds = {landmark.id: landmark.kind for landmark in model.landmarks}
        one = nees["nees_landmarks"]
        for prefix, names in (("area ", homes), ("kind ", kinds)):
            groups = [names[id_] for id_ in one.ids]
            parts += _groups("nees_landmarks", one.values, groups, prefix)
    if not errors:
        parts += [one for one in told if one.where]
    sentence = verdict(errors, innovations, parts)
    if errors:
        parts += [one for one in told if one.where]
    return Trusted(errors, innovations, tuple(parts), sentence)


def _groups(name: str, values: Array, groups: Sequence[str], prefix: str) -> list[Check]:
    """The mean of each group's values.

    Within a group they count as one: of an area the errors are nearly the same throughout.
    """
    out = []
    known = ~np.isnan(values)
    for group in sorted(set(groups) - {""}, key=_natural):
        chosen = known & (np.array(groups) == group)
        n = int(chosen.sum())
        one = Nees(float(values[chosen].mean()) if n else math.nan, n, values[chosen], 1.0)
        found = check(name, one, _DEGREES[name], prefix + group)
        if found is not None:
            out.append(found)
    return out


def _natural(name: str) -> tuple[str, int]:
    """A2 comes before A10."""
    digits = "".join(c for c in name if c.isdigit())
    return name.rstrip("0123456789"), int(digits) if digits else 0


def _areas_by_time(trajectory: Trajectory, events: Sequence[Mapping[str, Any]]) -> list[str]:
    """The area in which the robot was at each pose; empty before the first that is known."""
    entries = sorted(
        (float(event["t"]), str(event["area"]))
        for event in events
        if event.get("kind") in _ENTRIES and event.get("area")
    )
    if not entries:
        return [""] * len(trajectory.poses)
    begin = np.array([t for t, _ in entries])
    at = np.searchsorted(begin, trajectory.stamps_ns / 1e9 + 1e-6, side="right") - 1
    names = ["", *(area for _, area in entries)]
    return [names[i + 1] for i in at.tolist()]
