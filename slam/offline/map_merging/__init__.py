"""Merge sessions of one building into one map, without prior knowledge of their relative pose."""

from .consensus import Consensus
from .merge import MergedSession, merge_sessions

__all__ = ["Consensus", "MergedSession", "merge_sessions"]
