"""What a run can say, without any truth, of whether its covariances may be trusted.

The innovations of walls and ends (`innovations`) are put to the areas and the kinds of landmarks
that they belong to, and every loop is held against what the crossings before it had predicted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hiermap_cli.mapping.area_map import END
from hiermap_cli.mapping.association.innovations import Sums
from hiermap_cli.mapping.metrics import metric
from hiermap_cli.mapping.model import Metric

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from hiermap_cli.mapping.areas.found_areas import FoundArea
    from hiermap_cli.mapping.environment import LoopResidual
    from hiermap_cli.mapping.mapper import Mapper


@dataclass(frozen=True, slots=True)
class Loop:
    """A crossing that joined two areas which were joined already.

    residual: the place by way of the second area, (x, y, theta) seen from the place by way of the
    first; nis: its normalised square a degree of freedom, against what was known before any loop.
    """

    areas: tuple[str, str]
    residual: tuple[float, ...]
    nis: float


@dataclass(frozen=True, slots=True)
class Trust:
    """Sums of the innovations over all, by area and by kind of landmark; loops."""

    whole: Sums
    areas: dict[str, Sums]
    kinds: dict[str, Sums]
    loops: tuple[Loop, ...]

    @classmethod
    def of(cls, mapper: Mapper, found: Sequence[FoundArea], loops: Sequence[LoopResidual]) -> Trust:
        """Of a mapper that has taken in the whole log, by the areas of the result.

        loops: by the filter, before any of them was used.
        """
        areas: dict[str, Sums] = {}
        kinds: dict[str, Sums] = {}
        for i, one in enumerate(found):
            sums = _by_joined_uid(mapper, one)
            areas[f"A{i + 1}"] = _total(sums.values())
            f = one.area.map.features
            ends: dict[int, list[int]] = {}
            for uid, wall in zip(f.uid[f.kind == END], f.wall[f.kind == END], strict=True):
                ends.setdefault(int(wall), []).append(int(uid))
            for draft in one.drafts:
                walls = sorted({int(one.walls[line]) for line in draft.lines})
                parts = [uid for wall in walls for uid in (wall, *ends.get(wall, ()))]
                own = _total(sums[uid] for uid in parts if uid in sums)
                kinds[draft.kind] = kinds.get(draft.kind, Sums()).plus(own)
        return cls(
            whole=_total(areas.values()),
            areas=areas,
            kinds=dict(sorted(kinds.items())),
            loops=_loops(loops, found),
        )

    def metrics(self) -> tuple[Metric, ...]:
        """The figures of report.json; what had no sample is left out."""
        out = [
            Metric(f"nis_{kind}", "1", sums.nis, int(sums.matches))
            for kind, sums in self.kinds.items()
            if sums.degrees
        ]
        if not math.isnan(self.whole.lag1):
            out.append(metric("innovation_lag1", self.whole.lag1, int(self.whole.pairs)))
        if self.loops:
            mean = float(np.mean([loop.nis for loop in self.loops]))
            out.append(metric("loop_nis", mean, len(self.loops)))
        return tuple(out)

    def document(self) -> dict[str, Any]:
        """The key `consistency` of report.json."""
        return {
            "innovations": _figures(self.whole),
            "kinds": [{"kind": kind, **_figures(s)} for kind, s in self.kinds.items()],
            "areas": [{"area": area, **_figures(s)} for area, s in self.areas.items()],
            "loops": [
                {"areas": list(loop.areas), "residual": list(loop.residual), "nis": loop.nis}
                for loop in self.loops
            ],
        }


def _figures(sums: Sums) -> dict[str, Any]:
    """NIS and lag are null where there is nothing to tell them by."""
    nis, lag1 = sums.nis, sums.lag1
    return {
        "matches": int(sums.matches),
        "degrees": int(sums.degrees),
        "nis": None if math.isnan(nis) else nis,
        "lag1": None if math.isnan(lag1) else lag1,
        "pairs": int(sums.pairs),
    }


def _total(parts: Iterable[Sums]) -> Sums:
    total = Sums()
    for part in parts:
        total = total.plus(part)
    return total


def _by_joined_uid(mapper: Mapper, one: FoundArea) -> dict[int, Sums]:
    """Sums of an area's walls and ends by their uid in the joined map.

    What was forgotten since is among them: it was matched, and it counts for the area.
    """
    return {
        one.area.uid(part, uid): sums
        for part in one.area.parts
        for uid, sums in mapper.innovations.sums(part).items()
    }


def _loops(loops: Sequence[LoopResidual], found: Sequence[FoundArea]) -> tuple[Loop, ...]:
    number = {p: f"A{i + 1}" for i, one in enumerate(found) for p in one.area.parts}
    return tuple(
        Loop((number[one.link.a], number[one.link.b]), tuple(one.between.tolist()), one.nis)
        for one in loops
    )
