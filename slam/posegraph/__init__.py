"""2-D pose graphs, with landmarks or without: read, optimise, write. Knows nothing of scans, walls or recordings."""

from .files import PoseGraphFile, read_pose_graph, write_g2o, write_toro
from .model import Edges, PoseGraph
from .optimise import Optimised, optimise

__all__ = ["Edges", "Optimised", "PoseGraph", "PoseGraphFile", "optimise", "read_pose_graph", "write_g2o", "write_toro"]
