"""Status of a loop closure candidate."""

from __future__ import annotations

from enum import StrEnum


class LoopStatus(StrEnum):
    """Status of a loop closure candidate; the values are written to files."""

    REJECTED = "rejected"
    """A verification check failed, or the walls did not coincide after the closure."""
    PENDING = "pending"
    """All checks passed; waits for confirmation by a second candidate."""
    CONFIRMED = "confirmed"
    """Confirmed by a second candidate, not closed yet."""
    ACCEPTED = "accepted"
    """The loop was closed."""
    RETRACTED = "retracted"
    """Accepted before, contradicted by later scans, undone."""
