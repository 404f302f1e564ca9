"""The reference map of formats.md: what a building truly is, to judge a model against.

A list that is missing from the document stays None: what it would measure is left out.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from hiermap_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

T = TypeVar("T")

FORMAT = "hiermap-reference"
VERSION = (1, 0)


@dataclass(frozen=True, slots=True)
class ReferenceDoor:
    """A door or opening between two areas, from jamb `p1` to jamb `p2`, both (2,)."""

    id: str
    areas: tuple[str, str]
    p1: Array
    p2: Array
    visited: bool


@dataclass(frozen=True, slots=True)
class ReferenceArea:
    """A room or corridor: its polygon (m, 2), not closed; `visited` if the robot was there."""

    id: str
    kind: str
    polygon: Array
    visited: bool


@dataclass(frozen=True, slots=True)
class ReferenceMap:
    """Walls and furniture as segments `x1, y1, x2, y2`, (W, 4) and (F, 4); doors; areas."""

    walls: Array | None = None
    furniture: Array | None = None
    doors: tuple[ReferenceDoor, ...] | None = None
    areas: tuple[ReferenceArea, ...] | None = None


def read_reference(path: Path) -> ReferenceMap:
    """The reference map in a JSON file.

    Raises:
        InputError: the file cannot be read or is no reference map; every fault is in the one
            line, each with its place in the document.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; expected a reference map") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({error})") from None
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{path}: is not JSON ({error}); expected a reference.json or a map_server YAML"
        ) from None
    faults: list[str] = []
    reference = _parse(document, faults)
    if faults:
        raise InputError(f"{path}: not a usable reference map: " + "; ".join(faults))
    return reference


def reference_faults(document: object) -> list[str]:
    """Everything that keeps a JSON value from being a reference map, each with its place."""
    faults: list[str] = []
    _parse(document, faults)
    return faults


def reference_document(reference: ReferenceMap) -> dict[str, Any]:
    """The document of a reference map, ready to be written as JSON."""
    document: dict[str, Any] = {"format": FORMAT, "version": list(VERSION), "units": "m"}
    for name in ("walls", "furniture"):
        segments = getattr(reference, name)
        if segments is not None:
            document[name] = np.asarray(segments).tolist()
    if reference.doors is not None:
        document["doors"] = [
            {
                "id": door.id,
                "areas": list(door.areas),
                "p1": door.p1.tolist(),
                "p2": door.p2.tolist(),
                "visited": door.visited,
            }
            for door in reference.doors
        ]
    if reference.areas is not None:
        document["areas"] = [
            {
                "id": area.id,
                "kind": area.kind,
                "polygon": area.polygon.tolist(),
                "visited": area.visited,
            }
            for area in reference.areas
        ]
    return document


def _parse(document: object, faults: list[str]) -> ReferenceMap:
    """The map as far as it is sound; what is not is added to `faults`."""
    if not isinstance(document, dict):
        faults.append("the document is no object")
        return ReferenceMap()
    if document.get("format") != FORMAT:
        faults.append(f"format is {document.get('format')!r}, not '{FORMAT}'")
    version = document.get("version")
    if not (isinstance(version, list) and version and version[0] == VERSION[0]):
        faults.append(f"version is {version!r}, this program reads [{VERSION[0]}, ...]")
    if document.get("units") != "m":
        faults.append(f"units is {document.get('units')!r}, not 'm'")
    areas = _list(document, "areas", _area, faults)
    doors = _list(document, "doors", _door, faults)
    reference = ReferenceMap(
        walls=_segments(document, "walls", faults),
        furniture=_segments(document, "furniture", faults),
        doors=None if doors is None else tuple(doors),
        areas=None if areas is None else tuple(areas),
    )
    _check_ids(reference, _named(document), faults)
    return reference


def _named(document: dict[str, Any]) -> set[str]:
    """Ids of all areas that the document lists, those with faults too."""
    areas = document.get("areas")
    entries = areas if isinstance(areas, list) else []
    ids = [entry.get("id") for entry in entries if isinstance(entry, dict)]
    return {id_ for id_ in ids if isinstance(id_, str)}


def _check_ids(reference: ReferenceMap, known: set[str], faults: list[str]) -> None:
    for name, items in (("areas", reference.areas), ("doors", reference.doors)):
        ids = [item.id for item in items or ()]
        faults.extend(
            f"{name}: id {repeated!r} is used more than once"
            for repeated in sorted({i for i in ids if ids.count(i) > 1})
        )
    if reference.areas is not None:
        for door in reference.doors or ():
            faults.extend(
                f"doors: {door.id!r} leads to area {area!r}, which is not listed"
                for area in door.areas
                if area not in known
            )


def _list(
    document: dict[str, Any],
    name: str,
    parse: Callable[[dict[str, Any], str, list[str]], T | None],
    faults: list[str],
) -> list[T] | None:
    entries = document.get(name)
    if entries is None:
        return None
    if not isinstance(entries, list):
        faults.append(f"{name}: is no list")
        return None
    parsed = []
    for i, entry in enumerate(entries):
        place = f"{name}[{i}]"
        if not isinstance(entry, dict):
            faults.append(f"{place}: is no object")
            continue
        item = parse(entry, place, faults)
        if item is not None:
            parsed.append(item)
    return parsed


def _segments(document: dict[str, Any], name: str, faults: list[str]) -> Array | None:
    entries = document.get(name)
    if entries is None:
        return None
    if not isinstance(entries, list):
        faults.append(f"{name}: is no list")
        return None
    segments = []
    for i, entry in enumerate(entries):
        numbers = _numbers(entry, 4)
        if numbers is None:
            faults.append(f"{name}[{i}]: is not [x1, y1, x2, y2] in finite numbers")
        elif numbers[:2] == numbers[2:]:
            faults.append(f"{name}[{i}]: begins where it ends")
        else:
            segments.append(numbers)
    return np.array(segments, dtype=float).reshape(-1, 4)


def _numbers(value: object, count: int) -> list[float] | None:
    if not isinstance(value, list) or len(value) != count:
        return None
    for x in value:
        if isinstance(x, bool) or not isinstance(x, int | float) or not _is_finite(x):
            return None
    return [float(x) for x in value]


def _is_finite(x: float) -> bool:
    try:
        return math.isfinite(x)
    except OverflowError:  # an integer of hundreds of digits
        return False


def _common(entry: dict[str, Any], place: str, faults: list[str]) -> tuple[str, bool] | None:
    """The id and whether it was visited; a missing `visited` means that it was."""
    identifier, visited = entry.get("id"), entry.get("visited", True)
    sound = True
    if not isinstance(identifier, str) or not identifier:
        faults.append(f"{place}.id: is {identifier!r}, not a name")
        sound = False
    if not isinstance(visited, bool):
        faults.append(f"{place}.visited: is {visited!r}, neither true nor false")
        sound = False
    return (str(identifier), bool(visited)) if sound else None


def _door(entry: dict[str, Any], place: str, faults: list[str]) -> ReferenceDoor | None:
    common = _common(entry, place, faults)
    p1, p2 = _numbers(entry.get("p1"), 2), _numbers(entry.get("p2"), 2)
    for name, point in (("p1", p1), ("p2", p2)):
        if point is None:
            faults.append(f"{place}.{name}: is not [x, y] in finite numbers")
    areas = entry.get("areas")
    if not (isinstance(areas, list) and len(areas) == 2 and all(isinstance(a, str) for a in areas)):
        faults.append(f"{place}.areas: is {areas!r}, not the ids of two areas")
        return None
    if common is None or p1 is None or p2 is None:
        return None
    return ReferenceDoor(common[0], (areas[0], areas[1]), np.array(p1), np.array(p2), common[1])


def _area(entry: dict[str, Any], place: str, faults: list[str]) -> ReferenceArea | None:
    common = _common(entry, place, faults)
    kind, polygon = entry.get("kind", "unknown"), entry.get("polygon")
    sound = common is not None
    if not isinstance(kind, str):
        faults.append(f"{place}.kind: is {kind!r}, not a name")
        sound = False
    points = [_numbers(p, 2) for p in polygon] if isinstance(polygon, list) else []
    if len(points) < 3 or any(p is None for p in points):
        faults.append(f"{place}.polygon: is not a list of three or more [x, y] in finite numbers")
        return None
    corners = np.array(points, dtype=float)
    crossing = _crossing(corners)
    if crossing or abs(_twice_area(corners)) < 1e-9:
        faults.append(f"{place}.polygon: {crossing or 'has no area'}")
        sound = False
    if not sound or common is None:
        return None
    return ReferenceArea(common[0], kind, corners, common[1])


def _crossing(corners: Array) -> str:
    """Where a polygon (m, 2) crosses or touches itself; empty where it does not.

    One that is a mere line does not: it has no area.
    """
    import shapely  # only reference maps need it

    polygon = shapely.Polygon(corners)
    if polygon.is_valid:
        return ""
    reason: str = shapely.is_valid_reason(polygon)
    if len(np.unique(corners, axis=0)) < 3 or "[" not in reason:
        return ""
    if np.linalg.matrix_rank(corners - corners[0], tol=1e-9) < 2:
        return ""
    what, _, where = reason.partition("[")
    x, _, y = where.rstrip("]").partition(" ")
    return f"crosses itself ({what.strip().lower()}) at [{float(x):g}, {float(y):g}]"


def _twice_area(corners: Array) -> float:
    """Twice the signed area of a polygon (m, 2), by the shoelace formula."""
    x, y = (corners - corners.mean(axis=0)).T
    return float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
