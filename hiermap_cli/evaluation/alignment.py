"""How the model's frame lies in the reference's: by the trajectories, or by the maps alone.

Alignments by the maps alone are taken only where they are plain. A corridor fits another
building's corridor at many places about as well, so what decides is how far the best place stands
before the next: what it leaves unexplained must be clearly less (`DISTINCT`), half of the model
must be borne out at all, with hardly a wall where the reference is bare. What was measured to
choose these figures is in docs/evaluation.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.evaluation.evidence import SPACING
from hiermap_cli.evaluation.search import search

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.evaluation.evidence import ModelPoints, Raster
    from hiermap_cli.evaluation.search import Candidate

    Array = NDArray[np.float64]

DISTINCT = 1.33  # what the second best alignment leaves unexplained, over what the best does
AGAINST = 0.07  # share of walls that may stand where the reference is bare
CLEARLY = 0.1  # nats a metre of wall by which the second best must be worse in any case
BORNE_OUT = 0.5  # share of walls and of free ground that the reference must bear out
_LEAST = 3.0  # metres of wall that a model must have


class Alignment(NamedTuple):
    """R_t_g (3,), the model's frame g in the reference's t, or None with the reason.

    by: "trajectory" or "maps". best, second: the places that the search over maps found.
    """

    R_t_g: Array | None
    by: str
    reason: str = ""
    best: Candidate | None = None
    second: Candidate | None = None

    def document(self) -> dict[str, object]:
        """The key `alignment` of eval.json."""
        out: dict[str, object] = {
            "by": self.by,
            "pose": None if self.R_t_g is None else self.R_t_g.tolist(),
        }
        if self.reason:
            out["reason"] = self.reason
        for name, one in (("best", self.best), ("second", self.second)):
            if one is not None:
                out[name] = {
                    "pose": one.R_t_g.tolist(),
                    "surprise": one.surprise,
                    "walls": one.walls,
                    "ground": one.ground,
                    "against": one.against,
                }
        return out


def align_by_maps(model: ModelPoints, raster: Raster | None) -> Alignment:
    """The alignment of a model with a reference, where one is plain."""
    if raster is None:
        return Alignment(None, "maps", "the reference has neither walls nor areas to align by")
    if len(model.walls) * SPACING < _LEAST:
        return Alignment(None, "maps", "the model has hardly any wall to align by")
    found = search(model, raster)
    if not found:
        return Alignment(None, "maps", "no place was found where the maps' walls go together")
    best, second = found[0], found[1] if len(found) > 1 else None
    if best.walls < BORNE_OUT or best.ground < BORNE_OUT:
        return Alignment(
            None,
            "maps",
            f"the maps do not agree anywhere: at the best place {best.walls:.0%} of the walls and "
            f"{best.ground:.0%} of the free ground; is it the same building?",
            best,
            second,
        )
    if best.against > AGAINST:
        return Alignment(
            None,
            "maps",
            f"the maps contradict each other: at the best place {best.against:.0%} of the walls "
            "stand where the reference is bare; is it the same building?",
            best,
            second,
        )
    metres = len(model.walls) * SPACING
    asked = max(DISTINCT * best.surprise, best.surprise + CLEARLY * metres)
    if second is not None and second.surprise < asked:
        away = float(np.hypot(*(second.R_t_g - best.R_t_g)[:2]))
        return Alignment(
            None,
            "maps",
            f"two places fit about as well, {away:.1f} m apart (the second leaves "
            f"{second.surprise:.1f} nats unexplained, the first {best.surprise:.1f}; {asked:.1f} "
            "is asked for): give --trajectory; or it is another building",
            best,
            second,
        )
    return Alignment(best.R_t_g, "maps", "", best, second)
