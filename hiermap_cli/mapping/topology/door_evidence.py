"""What a narrow place must have to be a door: where it widens, and the wall beside it.

A door's leaf that stands open is as long as the door is wide, and the path no wider along it than
in the door: it widens behind the leaf. And a doorway may be wider than others by a hand, if there
is more wall on the line through its jambs, which furniture has not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hiermap_cli.config import DoorConfig
    from hiermap_cli.mapping.topology.passage import Passage

LEAF = 0.9  # metres: no leaf is longer
PAST = 0.1  # metres of path behind an open leaf on which it widens
STEEP = 3.0  # metres of wall for each metre that a door is wider than doors are
WIDER = 0.25  # metres that a door may be wider: beyond, there is not so much wall to be seen


def reach_of(width: float, config: DoorConfig) -> float:
    """Metres of path on which a narrow place of this width must widen."""
    return max(config.reach, min(width, LEAF) + PAST)


def longest_reach(config: DoorConfig) -> float:
    """The longest of them all."""
    return reach_of(LEAF, config)


def needed(width: float) -> float:
    """Metres of wall beside the jambs, less openings, that make a door of this width.

    As much as the width, and a metre beside a narrow one: two pieces of furniture that stand
    near each other have some wall or other beside them.
    """
    return max(1.0, width)


def demanded(width: float, config: DoorConfig) -> float:
    """Metres of wall, less openings, of a door; more of a wider one than doors are."""
    over = max(width - config.max_width, 0.0)
    return config.min_evidence * needed(width) + STEEP * over


def is_door(passage: Passage, config: DoorConfig) -> bool:
    """Whether there is wall enough beside a narrow place."""
    return passage.evidence >= demanded(passage.width, config)
