"""A second look at a whole run: everything associated again with the map that came of it, and solved in batch."""

from .drive import Drive, drive_of
from .refiner import Refined, laid_path, refine

__all__ = ["Drive", "Refined", "drive_of", "laid_path", "refine"]
