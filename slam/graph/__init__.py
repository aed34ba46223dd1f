"""The factor graph; the only place that knows GTSAM."""

from .backend import KERNEL_CAUTION, FactorGraph
from .chain import smooth_chain
from .factors import CAUCHY_SCALES, Factor, GraphState, Kind, root_information

__all__ = [
    "CAUCHY_SCALES",
    "KERNEL_CAUTION",
    "Factor",
    "FactorGraph",
    "GraphState",
    "Kind",
    "root_information",
    "smooth_chain",
]
