"""The factor graph; the only place that knows GTSAM."""

from .backend import FactorGraph
from .chain import smooth_chain

__all__ = ["FactorGraph", "smooth_chain"]
