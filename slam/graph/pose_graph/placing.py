"""Where vertices are, as far as the edges alone say it without any averaging."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from drivers import se2

from .model import Floats, Integers, PoseGraph

REACH = 1.0
"""Metres; a landmark whose bearings do not meet is put this far along the first."""
UNSURE = 1e-4
"""Weight of that place against the bearings': it counts where they are parallel to within a hundredth of a radian."""


def components(graph: PoseGraph) -> Integers:
    """(n + m,): for each pose, then each landmark, the number of the connected part of the graph that it belongs to."""
    source = np.concatenate([edges.source for edges in graph.kinds])
    poses, count = len(graph.poses), len(graph.poses) + len(graph.landmarks)
    target = np.concatenate([graph.motions.target, *(poses + edges.target for edges in graph.kinds[1:])])
    links = coo_array((np.ones(len(source)), (source, target)), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)


def place_along_edges(graph: PoseGraph) -> PoseGraph:
    """The graph with poses strung along motions, odometry before others, and landmarks where they are seen first.

    The first pose of each connected part is at the origin.
    """
    placed = graph.with_estimate(_string_poses(graph), graph.landmarks)
    landmarks = intersect_bearings(placed)
    seen, first = np.unique(graph.positions.target, return_index=True)
    observers = placed.poses[graph.positions.source[first]]
    landmarks[seen] = se2.transform(observers, graph.positions.measured[first])
    return placed.with_estimate(placed.poses, landmarks)


def _string_poses(graph: PoseGraph) -> Floats:
    """(n, 3): poses along a spanning tree of the motions between poses that are next to each other in the file."""
    motions, count = graph.motions, len(graph.poses)
    pairs, edge_of_pair = np.unique(
        np.sort(np.stack([motions.source, motions.target], axis=1), axis=1), axis=0, return_index=True
    )
    nearness = coo_array((pairs[:, 1] - pairs[:, 0], pairs.T), shape=(count, count)).tocsr()
    tree = minimum_spanning_tree(nearness)
    edge = {(int(a), int(b)): int(k) for (a, b), k in zip(pairs, edge_of_pair, strict=True)}
    poses = np.zeros((count, 3))
    _, part = connected_components(tree, directed=False)
    for root in np.unique(part, return_index=True)[1]:
        order, before = breadth_first_order(tree, root, directed=False)
        for pose in order[1:]:
            known = int(before[pose])
            k = edge[min(known, int(pose)), max(known, int(pose))]
            motion = motions.measured[k] if motions.source[k] == known else se2.inverse(motions.measured[k])
            poses[pose] = se2.compose(poses[known], motion)
    return poses


def intersect_bearings(graph: PoseGraph) -> Floats:
    """(m, 2): the landmarks; those of which there are bearings where these come nearest to each other."""
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
    seen, first = np.unique(bearings.target, return_index=True)
    unsure = UNSURE * np.eye(2)
    guess = observers[first, :2] + REACH * along[first]
    landmarks[seen] = np.linalg.solve(matrix[seen] + unsure, (right[seen] + UNSURE * guess)[:, :, None])[:, :, 0]
    return landmarks
