"""The factor graph; the only place that knows GTSAM."""

from .backend import FactorGraph
from .chain import smooth_chain
from .factors import Factor, GraphState, Kind

__all__ = ["Factor", "FactorGraph", "GraphState", "Kind", "smooth_chain"]
