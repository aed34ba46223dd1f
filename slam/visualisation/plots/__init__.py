"""Pictures as PNG files. matplotlib is imported when one is drawn, not before."""

from .evaluation import plot_reference, plot_relations
from .map import plot_map
from .posegraph import plot_pose_graph
from .scan import plot_scan

__all__ = ["plot_map", "plot_pose_graph", "plot_reference", "plot_relations", "plot_scan"]
