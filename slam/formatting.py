"""Format numbers with units for people."""

from __future__ import annotations

from drivers.elapsed import HOUR, MINUTE


def duration(seconds: float) -> str:
    """Return a duration in seconds, minutes or hours, by its size."""
    if seconds < 2 * MINUTE:
        return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"
    return f"{seconds / MINUTE:.0f} min" if seconds < 2 * HOUR else f"{seconds / HOUR:.1f} h"


def length(metres: float) -> str:
    """Return a length in mm, cm or m, by its size, with about three digits."""
    size = abs(metres)
    if size < 0.1:
        return f"{1e3 * metres:.1f} mm" if size < 0.01 else f"{1e2 * metres:.1f} cm"
    return f"{metres:.2f} m" if size < 10 else f"{metres:.0f} m"


def percent(share: float, digits: int = 0) -> str:
    """Return a ratio in per cent, with some digits after the decimal point."""
    return f"{100 * share:.{digits}f} %"


def percent_apart(share: float, limit: float) -> str:
    """Return a ratio in per cent, with as many digits, up to 6, as tell it from a limit in per cent."""
    return percent(share, next((digits for digits in range(6) if percent(share, digits) != percent(limit, digits)), 6))


def counted(count: int, noun: str) -> str:
    """Return a count with its noun, in the plural unless it is 1."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
