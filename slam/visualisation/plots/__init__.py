"""Draw results as PNG files. matplotlib is imported only when a plot is drawn."""

from ...extras import require_extra
from .map import plot_map
from .pose_graph import plot_pose_graph
from .scan import plot_scan
from .trajectory_errors import plot_reference, plot_relations

__all__ = ["plot_map", "plot_pose_graph", "plot_reference", "plot_relations", "plot_scan"]

require_extra("plots")
