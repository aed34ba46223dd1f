"""Data model: a 2-D pose graph as arrays of poses, landmarks and measurements between them (edges).

Measurements are of three kinds, all made from a pose:

    motions    another pose [x, y, heading] in the first one's frame    (EDGE_SE2)
    positions  a landmark's [x, y] in the pose's frame                  (EDGE_SE2_XY)
    bearings   a landmark's direction in the pose's frame               (EDGE_BEARING_SE2_XY)

Arrays over all edges (edge_count,) have them in this order. Units are metres and radians; an information matrix is the
inverse of the measurement's covariance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.immutable import immutable

from ...geometry.segments import Floats, Integers

Flags = NDArray[np.bool_]


@immutable
class Edges:
    """k measurements of one kind, with d components each."""

    source: Integers
    """(k,): index of the pose from which each is made."""
    target: Integers
    """(k,): index of the pose or landmark that is measured."""
    measured: Floats
    """(k, d)."""
    information: Floats
    """(k, d, d), symmetric and positive semidefinite; singular if a direction was not measured."""
    line: Integers
    """(k,): number of its line in the file, from 1; 0 if it is not from a file."""

    def __len__(self) -> int:
        return len(self.source)

    def select(self, mask: Flags) -> Edges:
        """Return the edges for which `mask` (k,) is true."""
        return Edges(self.source[mask], self.target[mask], self.measured[mask], self.information[mask], self.line[mask])


@immutable
class PoseGraph:
    """Poses, landmarks and edges."""

    pose_ids: Integers
    """(n,), distinct from each other and from the landmark ids."""
    poses: Floats
    """(n, 3): the estimate, in the graph's frame."""
    landmark_ids: Integers
    """(m,)."""
    landmarks: Floats
    """(m, 2): the estimate."""
    motions: Edges
    positions: Edges
    bearings: Edges
    fixed_poses: Flags
    """(n,): true for poses that the optimiser must not move."""
    fixed_landmarks: Flags
    """(m,)."""

    @property
    def edges_by_kind(self) -> tuple[Edges, Edges, Edges]:
        """Motions, positions and bearings."""
        return self.motions, self.positions, self.bearings

    @property
    def edge_count(self) -> int:
        """Number of edges of all kinds."""
        return sum(len(edges) for edges in self.edges_by_kind)

    def select_edges(self, mask: Flags) -> PoseGraph:
        """Return the graph with only the edges for which `mask` (edge_count,) is true."""
        first, second = len(self.motions), len(self.motions) + len(self.positions)
        return replace(
            self,
            motions=self.motions.select(mask[:first]),
            positions=self.positions.select(mask[first:second]),
            bearings=self.bearings.select(mask[second:]),
        )

    def with_estimate(self, poses: Floats, landmarks: Floats) -> PoseGraph:
        """Return the graph with other poses (n, 3) and landmarks (m, 2)."""
        return replace(self, poses=poses, landmarks=landmarks)
