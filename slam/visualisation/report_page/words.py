"""Numbers as a person reads them."""

from __future__ import annotations

MINUTE, HOUR = 60, 3600


def clock(seconds: float) -> str:
    """Minutes and seconds into the drive, and hours where there are."""
    whole = max(0, int(seconds))
    hours, minutes, rest = whole // HOUR, whole % HOUR // MINUTE, whole % MINUTE
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def duration(seconds: float) -> str:
    """A span of time in the units that suit it."""
    if seconds < 2 * MINUTE:
        return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"
    return f"{seconds / MINUTE:.0f} min" if seconds < 2 * HOUR else f"{seconds / HOUR:.1f} h"


def length(metres: float) -> str:
    """A length in the unit that suits it, of about three digits."""
    size = abs(metres)
    if size < 0.1:
        return f"{1e3 * metres:.1f} mm" if size < 0.01 else f"{1e2 * metres:.1f} cm"
    return f"{metres:.2f} m" if size < 10 else f"{metres:.0f} m"


def percent(share: float) -> str:
    """A share of one, in per cent."""
    return f"{100 * share:.0f} %"


def counted(count: int, noun: str) -> str:
    """So many of something."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
