"""2-D pose graphs, with or without landmarks: read, optimise, write. Independent of the rest of the package."""

from .files import G2O_EDGES, PoseGraphFile, read_pose_graph, write_g2o
from .model import Edges, PoseGraph
from .optimise import OptimisedGraph, optimise
from .pairwise_consistency import odometry_edges

__all__ = [
    "G2O_EDGES",
    "Edges",
    "OptimisedGraph",
    "PoseGraph",
    "PoseGraphFile",
    "odometry_edges",
    "optimise",
    "read_pose_graph",
    "write_g2o",
]
