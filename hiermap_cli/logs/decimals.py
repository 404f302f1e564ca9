"""Decimal stamps to integer nanoseconds, without a detour over floating point."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation

LIMIT_NS = 2**62  # beyond the year 2100 and far from where int64 overflows


def seconds_to_ns(text: bytes | str) -> int:
    """Exact nanoseconds of a decimal number of seconds, digits beyond the ninth cut off.

    Raises ValueError where the text is no finite decimal number, or beyond any clock.
    """
    if isinstance(text, str):
        text = text.encode("ascii", "replace")
    whole, _, fraction = text.partition(b".")
    # For bytes, isdigit means the ten ASCII digits.
    if whole.isdigit() and fraction.isdigit() and len(whole) < 20:
        stamp = int(whole + fraction[:9].ljust(9, b"0"))
    else:
        stamp = _by_decimal(text.decode("ascii", "replace"))
    if abs(stamp) > LIMIT_NS:
        message = f"stamp out of range: {text!r}"
        raise ValueError(message)
    return stamp


def _by_decimal(text: str) -> int:
    try:
        value = Decimal("nan" if "_" in text else text)
    except InvalidOperation:
        value = Decimal("nan")
    if not value.is_finite() or abs(value) > LIMIT_NS:
        message = f"not a stamp: {text!r}"
        raise ValueError(message)
    return int(value.scaleb(9))


def ns_to_seconds(stamp_ns: int) -> str:
    """Seconds with nine decimals, printed from the integer."""
    sign = "-" if stamp_ns < 0 else ""
    seconds, rest = divmod(abs(stamp_ns), 1_000_000_000)
    return f"{sign}{seconds}.{rest:09d}"
