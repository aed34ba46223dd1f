"""Manual corrections of a session: loops closed or forbidden, walls tied or deleted, pins to a survey."""

from .apply import CorrectedSession, correct_session

__all__ = ["CorrectedSession", "correct_session"]
