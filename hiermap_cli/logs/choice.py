"""Which topics a run uses: chosen by type, then by name; where two fit, nobody guesses."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from hiermap_cli.errors import InputError
from hiermap_cli.logs import records as kinds

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hiermap_cli.logs.records import Topic

SCAN_KINDS = (kinds.SCANS, kinds.SCANS_WITH_ODOMETRY)

# In this order; a topic that ends like one of them (`/robot1/scan`) fits where none is exact.
SCAN_NAMES = ("/scan", "scan", "FLASER", "ROBOTLASER1", "RAWLASER1", "L")
ODOMETRY_NAMES = ("/odom", "odom", "/odometry", "odometry", "ODOM", "O")

JOIN = "+"  # between the topics of an odometry that comes in two kinds of records
EDGE = ":"  # between a transform topic and the edge, `/tf:odom->base_link`
ARROW = "->"


class OdometryChoice(NamedTuple):
    """Where odometry comes from; `edge` is (frame, child) where transforms give it, if known."""

    name: str
    topics: frozenset[str]
    edge: tuple[str, str] | None
    from_transforms: bool


def describe(topics: Sequence[Topic]) -> str:
    """A line of topics with their types, at most eight of them."""
    if not topics:
        return "none"
    listed = ", ".join(f"{topic.name} ({topic.type})" for topic in topics[:8])
    return listed + (f" and {len(topics) - 8} more" if len(topics) > 8 else "")


def choose_scans(log: str, topics: Sequence[Topic], wanted: str | None) -> Topic:
    """The topic of the scans. Raises InputError where none fits, or two."""
    fitting = [topic for topic in topics if topic.kind in SCAN_KINDS]
    if wanted is not None:
        return _named(log, topics, fitting, wanted, "--scan-topic", "laser scans")
    fitting = _not_empty(fitting)
    if not topics:
        raise InputError(f"{log}: no topic in it can be read")
    if not fitting:
        raise InputError(f"{log}: no laser scans in it, only {describe(topics)}")
    return _one(log, fitting, SCAN_NAMES, "--scan-topic", "laser scans")


def choose_odometry(
    log: str, topics: Sequence[Topic], scans: Topic, wanted: str | None
) -> OdometryChoice:
    """Where odometry comes from. Raises InputError where nothing fits, or two topics do.

    Static transforms never do: they say how the robot is built, not how it moves.
    """
    fitting = [topic for topic in topics if topic.kind == kinds.ODOMETRY]
    carried = scans.kind == kinds.SCANS_WITH_ODOMETRY
    transforms = [topic for topic in topics if topic.kind == kinds.TRANSFORMS]
    if wanted is not None:
        return _wanted_odometry(log, topics, scans, wanted)
    usable = _not_empty(fitting)
    if carried:
        names = [topic.name for topic in usable] + [scans.name]
        return OdometryChoice(JOIN.join(names), frozenset(names), None, from_transforms=False)
    if usable:
        name = _one(log, usable, ODOMETRY_NAMES, "--odom-topic", "odometry").name
        return OdometryChoice(name, frozenset([name]), None, from_transforms=False)
    if _not_empty(transforms):
        names = [topic.name for topic in transforms]
        return OdometryChoice(JOIN.join(names), frozenset(names), None, from_transforms=True)
    raise InputError(f"{log}: no odometry in it, only {describe(topics)}")


def _wanted_odometry(
    log: str, topics: Sequence[Topic], scans: Topic, wanted: str
) -> OdometryChoice:
    edge = None
    name = wanted
    if ARROW in wanted and EDGE in wanted:
        name, _, text = wanted.rpartition(EDGE)
        frame, _, child = text.partition(ARROW)
        edge = (frame.strip(), child.strip())
    fitting = [
        topic
        for topic in topics
        if topic.kind in (kinds.ODOMETRY, kinds.TRANSFORMS)
        or (topic.name == scans.name and scans.kind == kinds.SCANS_WITH_ODOMETRY)
    ]
    parts = [topic.name for topic in topics if topic.name == name] or name.split(JOIN)
    chosen = [_named(log, topics, fitting, part, "--odom-topic", "odometry") for part in parts]
    moving = chosen[0].kind == kinds.TRANSFORMS
    return OdometryChoice(name, frozenset(topic.name for topic in chosen), edge, moving)


def _not_empty(topics: list[Topic]) -> list[Topic]:
    return [topic for topic in topics if topic.messages != 0]


def _named(
    log: str, topics: Sequence[Topic], fitting: list[Topic], wanted: str, option: str, what: str
) -> Topic:
    for topic in fitting:
        if topic.name == wanted:
            return topic
    for topic in topics:
        if topic.name == wanted:
            held = kinds.STATIC_TRANSFORMS if topic.kind == kinds.STATIC_TRANSFORMS else topic.type
            raise InputError(
                f"{log}: {option} {wanted} holds {held}, no {what}; fitting: {describe(fitting)}"
            )
    raise InputError(f"{log}: no topic {wanted} ({option}) in it; fitting: {describe(fitting)}")


def _one(log: str, fitting: list[Topic], names: Sequence[str], option: str, what: str) -> Topic:
    if len(fitting) == 1:
        return fitting[0]
    for name in names:
        exact = [topic for topic in fitting if topic.name == name]
        if len(exact) == 1:
            return exact[0]
    for name in names:
        ending = "/" + name.lstrip("/")
        alike = [topic for topic in fitting if topic.name.endswith(ending)]
        if len(alike) == 1:
            return alike[0]
        if alike:
            break
    raise InputError(
        f"{log}: {len(fitting)} topics hold {what}: {describe(fitting)}; choose one by {option}"
    )
