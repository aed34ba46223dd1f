"""The factor graph; the only place that knows GTSAM."""

from .backend import CLOSING_UPDATES, KERNEL_CAUTION, FactorGraph
from .chain import smooth_chain
from .factors import CAUCHY_SCALES, Factor, GraphState, Kind, root_information

__all__ = [
    "CAUCHY_SCALES",
    "CLOSING_UPDATES",
    "KERNEL_CAUTION",
    "Factor",
    "FactorGraph",
    "GraphState",
    "Kind",
    "root_information",
    "smooth_chain",
]
