"""Offline refinement: associate all scans of a session again with its whole map, and solve in batch."""

from .refiner import RefinementResult, match_trajectory, refine
from .scan_history import ScanHistory, build_scan_history

__all__ = ["RefinementResult", "ScanHistory", "build_scan_history", "match_trajectory", "refine"]
