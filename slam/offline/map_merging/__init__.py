"""Merge sessions of one building into one map, without prior knowledge of their relative pose."""

from .merge import MergedSession, merge_sessions
from .session_location import SessionLocation

__all__ = ["MergedSession", "SessionLocation", "merge_sessions"]
