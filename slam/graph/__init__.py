"""The factor graph; the only place that knows GTSAM."""

from .backend import CLOSING_UPDATES, FactorGraph
from .chain import smooth_chain
from .covariances import KERNEL_CAUTION
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
