"""Sessions of one building made one map, without knowing where they lie in each other."""

from .agreement import Agreement
from .join import Joined, join

__all__ = ["Agreement", "Joined", "join"]
