"""The factor graph; the only place that knows GTSAM."""

from .backend import FactorGraph
from .chain import smooth_chain
from .factors import CAUCHY_SCALES, Factor, GraphState, Kind, root_information

__all__ = ["CAUCHY_SCALES", "Factor", "FactorGraph", "GraphState", "Kind", "root_information", "smooth_chain"]
