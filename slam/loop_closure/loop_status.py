"""Status of a loop."""

from __future__ import annotations

from enum import StrEnum


class LoopStatus(StrEnum):
    """Status of a loop; the values are written to files."""

    REJECTED = "rejected"
    """Not closed: a check failed, such as the number of looks that agree, or the map did not fit together then."""
    CONFIRMED = "confirmed"
    """Enough looks agree; not closed yet."""
    ACCEPTED = "accepted"
    """The loop was closed."""
    RETRACTED = "retracted"
    """Accepted before, contradicted by later scans, undone."""
    FORBIDDEN = "forbidden"
    """Accepted before, undone by a person."""
