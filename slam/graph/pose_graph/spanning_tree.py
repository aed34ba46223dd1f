"""Initial estimate of a graph's vertices from a spanning tree of its edges, and its connected components."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from drivers import se2

from ...geometry.segments import Floats, Integers
from .model import PoseGraph

# Metres; a landmark whose bearings do not intersect is placed at this distance along the first one.
# Origin: numerical, any value serves as an initial estimate.
DEFAULT_RANGE = 1.0
# Weight of that position relative to a bearing: it matters if all bearings are parallel to within 0.01 rad.
# Origin: numerical.
DEFAULT_RANGE_WEIGHT = 1e-4


def components(graph: PoseGraph) -> Integers:
    """Return the index (n + m,) of the connected component of each pose, then of each landmark."""
    source = np.concatenate([edges.source for edges in graph.edges_by_kind])
    poses, count = len(graph.poses), len(graph.poses) + len(graph.landmarks)
    target = np.concatenate([graph.motions.target, *(poses + edges.target for edges in graph.edges_by_kind[1:])])
    links = coo_array((np.ones(len(source)), (source, target)), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)


def place_along_edges(graph: PoseGraph) -> PoseGraph:
    """Return the graph with an initial estimate from its edges.

    Poses are composed from motions, odometry before others; landmarks are placed by their first observation. The first
    pose of each connected component is at the origin.
    """
    initial = graph.with_estimate(_compose_poses(graph), graph.landmarks)
    landmarks = intersect_bearings(initial)
    observed, first = np.unique(graph.positions.target, return_index=True)
    observers = initial.poses[graph.positions.source[first]]
    landmarks[observed] = se2.transform(observers, graph.positions.measured[first])
    return initial.with_estimate(initial.poses, landmarks)


def _compose_poses(graph: PoseGraph) -> Floats:
    """Return poses (n, 3) composed along a spanning tree that prefers motions between poses near each other in the
    file."""
    motions, count = graph.motions, len(graph.poses)
    pairs, edge_of_pair = np.unique(
        np.sort(np.stack([motions.source, motions.target], axis=1), axis=1), axis=0, return_index=True
    )
    index_distance = coo_array((pairs[:, 1] - pairs[:, 0], pairs.T), shape=(count, count)).tocsr()
    tree = minimum_spanning_tree(index_distance)
    edge = {(int(a), int(b)): int(k) for (a, b), k in zip(pairs, edge_of_pair, strict=True)}
    poses = np.zeros((count, 3))
    _, component = connected_components(tree, directed=False)
    for root in np.unique(component, return_index=True)[1]:
        order, predecessors = breadth_first_order(tree, root, directed=False)
        for pose in order[1:]:
            parent = int(predecessors[pose])
            k = edge[min(parent, int(pose)), max(parent, int(pose))]
            motion = motions.measured[k] if motions.source[k] == parent else se2.inverse(motions.measured[k])
            poses[pose] = se2.compose(poses[parent], motion)
    return poses


def intersect_bearings(graph: PoseGraph) -> Floats:
    """Return the landmarks (m, 2), those with bearings at the least-squares intersection of these."""
    bearings = graph.bearings
    observers = graph.poses[bearings.source]
    angle = observers[:, 2] + bearings.measured[:, 0]
    along = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    information = across[:, :, None] * across[:, None, :]
    landmarks = graph.landmarks.copy()
    matrix, right = np.zeros((len(landmarks), 2, 2)), np.zeros((len(landmarks), 2))
    np.add.at(matrix, bearings.target, information)
    np.add.at(right, bearings.target, (information @ observers[:, :2, None])[:, :, 0])
    observed, first = np.unique(bearings.target, return_index=True)
    regularisation = DEFAULT_RANGE_WEIGHT * np.eye(2)
    default = observers[first, :2] + DEFAULT_RANGE * along[first]
    right_hand_side = (right[observed] + DEFAULT_RANGE_WEIGHT * default)[:, :, None]
    landmarks[observed] = np.linalg.solve(matrix[observed] + regularisation, right_hand_side)[:, :, 0]
    return landmarks
