"""Manual corrections of a session: walls tied or deleted, poses and walls pinned to surveyed coordinates."""

from .apply import CorrectedSession, correct_session

__all__ = ["CorrectedSession", "correct_session"]
