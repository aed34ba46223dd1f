"""The factor graph; the only place that knows GTSAM."""

from .backend import KERNEL_CAUTION, FactorGraph
from .chain import smooth_chain

__all__ = ["KERNEL_CAUTION", "FactorGraph", "smooth_chain"]
