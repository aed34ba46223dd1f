"""Times since the start of a recording or a run, as text for people."""

from __future__ import annotations

MINUTE, HOUR = 60, 3600


def elapsed(seconds: float) -> str:
    """Return `minutes:seconds`, or `hours:minutes:seconds` from one hour on; earlier than the start with a minus."""
    whole = int(round(abs(seconds), 3))  # differences of stamps are not exact
    sign = "-" if seconds < 0.0 and whole else ""
    hours, minutes, rest = whole // HOUR, whole % HOUR // MINUTE, whole % MINUTE
    return f"{sign}{hours}:{minutes:02d}:{rest:02d}" if hours else f"{sign}{minutes}:{rest:02d}"


def parse_elapsed(text: str) -> float:
    """Return the seconds that `elapsed` has written. Raises ValueError if it cannot have written the text."""
    parts = text.split(":")
    if len(parts) not in (2, 3) or not all(part.isdecimal() and len(part) < 10 for part in parts):
        raise ValueError(f"{text!r} is not a time since the start")
    seconds = 0
    for part in parts:
        seconds = MINUTE * seconds + int(part)
    return float(seconds)
