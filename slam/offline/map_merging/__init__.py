"""Merge sessions of one building into one map, without prior knowledge of their relative pose."""

from .merge import MergedSession, merge_sessions

__all__ = ["MergedSession", "merge_sessions"]
