"""Durations and sizes as people write them: `90`, `10m`, `1.5h`; `500MB`, `2GiB`."""

from __future__ import annotations

import math
import re

_SECONDS = {"": 1.0, "s": 1.0, "min": 60.0, "m": 60.0, "h": 3600.0, "d": 86400.0}
_BYTES = {
    "": 1,
    "b": 1,
    "k": 1000,
    "kb": 1000,
    "kib": 1 << 10,
    "m": 1000**2,
    "mb": 1000**2,
    "mib": 1 << 20,
    "g": 1000**3,
    "gb": 1000**3,
    "gib": 1 << 30,
    "t": 1000**4,
    "tb": 1000**4,
    "tib": 1 << 40,
}
_QUANTITY = re.compile(r"\s*([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*([A-Za-z]*)\s*")


def parse_seconds(given: float | str) -> float:
    """Seconds in a number or a text such as `90`, `90s`, `10m`, `1.5h`.

    Raises:
        ValueError: it is no duration above zero; the message says how to write one.
    """
    seconds = _number(given, _SECONDS)
    if seconds is None or seconds <= 0:
        raise ValueError(f"{given!r} is no duration: write seconds, or as in 90s, 10m, 1.5h")
    return seconds


def parse_bytes(given: float | str) -> int:
    """Bytes in a number or a text such as `500MB`, `2GB`, `1.5GiB`.

    Raises:
        ValueError: it is no size of at least one byte; the message says how to write one.
    """
    size = _number(given, _BYTES)
    if size is None or size < 1:
        raise ValueError(f"{given!r} is no size: write bytes, or as in 500MB, 2GB, 1.5GiB")
    return int(size)


def _number(given: float | str, units: dict[str, float] | dict[str, int]) -> float | None:
    if isinstance(given, bool):
        return None
    if isinstance(given, int | float):
        return float(given) if math.isfinite(given) else None
    found = _QUANTITY.fullmatch(given)
    factor = units.get(found[2].lower()) if found else None
    if found is None or factor is None:
        return None
    value = float(found[1]) * factor
    return value if math.isfinite(value) else None


def bytes_text(size: float) -> str:
    """A size for a person, in powers of ten: `1.5 GB`."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= factor:
            return f"{size / factor:.3g} {unit}"
    return f"{size:.0f} B"


def seconds_text(seconds: float) -> str:
    """A duration for a person: `3.2 s`, `4 min 10 s`, `2 h 5 min`."""
    if seconds < 0.1:
        return "under 0.1 s"
    if seconds < 60:
        return f"{seconds:.3g} s"
    whole = round(seconds)
    minutes, rest = divmod(whole, 60)
    if minutes < 60:
        return f"{minutes} min {rest} s" if rest else f"{minutes} min"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if minutes else f"{hours} h"
