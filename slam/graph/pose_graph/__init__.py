"""2-D pose graphs, with landmarks or without: read, optimise, write. Knows nothing of scans, walls or recordings."""

from .files import G2O_EDGES, PoseGraphFile, read_pose_graph, write_g2o, write_toro
from .model import Edges, PoseGraph
from .optimise import Optimised, optimise
from .support import odometry_edges

__all__ = [
    "G2O_EDGES",
    "Edges",
    "Optimised",
    "PoseGraph",
    "PoseGraphFile",
    "odometry_edges",
    "optimise",
    "read_pose_graph",
    "write_g2o",
    "write_toro",
]
