"""The factor graph; the only place that knows GTSAM."""

from .backend import FactorGraph

__all__ = ["FactorGraph"]
