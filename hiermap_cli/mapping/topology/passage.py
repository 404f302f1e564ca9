"""A narrow place that the robot has passed, be it a door or not."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


class Passage(NamedTuple):
    """A narrow place that the robot has passed.

    frame: (3,) origin midway between the jambs, X along the line between them, Y in the
    direction of crossing. width: metres between the jambs. travelled: metres of path at which it
    was passed. wall, open: (2,) metres of the line beside each jamb (left of the crossing is the
    negative X, first) that are wall, and that beams have passed.
    """

    frame: Array
    width: float
    travelled: float
    wall: Array
    open: Array

    @property
    def evidence(self) -> float:
        """Metres of wall beside the jambs less metres that are open."""
        return float(self.wall.sum() - self.open.sum())

    @property
    def figures(self) -> dict[str, object]:
        """What an event tells of it."""
        return {"width": self.width, "wall": self.wall.tolist(), "open": self.open.tolist()}
