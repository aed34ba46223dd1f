"""The factor graph; the only place that knows GTSAM."""

from .backend import FactorGraph
from .chain import smooth_chain
from .factors import CAUCHY_SCALES, Factor, GraphState, Kind

__all__ = ["CAUCHY_SCALES", "Factor", "FactorGraph", "GraphState", "Kind", "smooth_chain"]
