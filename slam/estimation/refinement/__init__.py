"""A second look at a whole run: everything associated again with the map that came of it, and solved in batch."""

from .refiner import Refined, match_trajectory, refine
from .scan_history import ScanHistory, build_scan_history

__all__ = ["Refined", "ScanHistory", "build_scan_history", "match_trajectory", "refine"]
