"""A 2-D pose graph as arrays: poses and landmarks, and what was measured between them.

Measurements are of three kinds, all made from a pose:

    motions    another pose [x, y, heading] in the first one's frame    (EDGE_SE2)
    positions  a landmark's [x, y] in the pose's frame                  (EDGE_SE2_XY)
    bearings   a landmark's direction in the pose's frame               (EDGE_BEARING_SE2_XY)

Where all edges are counted together they come in this order. Metres and radians; an information matrix is the inverse
of the measurement's covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """k measurements of one kind, each of d numbers."""

    source: Integers
    """(k,): index of the pose that each is made from."""
    target: Integers
    """(k,): index of the pose or landmark that is measured."""
    measured: Floats
    """(k, d)."""
    information: Floats
    """(k, d, d), symmetric and positive semidefinite; a direction that was not measured has none."""
    line: Integers
    """(k,): the line of the file that tells of it, from 1; 0 if it is from no file."""

    def __len__(self) -> int:
        return len(self.source)

    def select(self, kept: Flags) -> Edges:
        """Those for which `kept` (k,) holds."""
        return Edges(self.source[kept], self.target[kept], self.measured[kept], self.information[kept], self.line[kept])


@dataclass(frozen=True, slots=True, eq=False)
class PoseGraph:
    """Poses, landmarks and the measurements between them."""

    pose_ids: Integers
    """(n,), distinct from each other and from the landmarks'."""
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
    """(n,): those that the optimiser must not move."""
    fixed_landmarks: Flags
    """(m,)."""

    @property
    def kinds(self) -> tuple[Edges, Edges, Edges]:
        """All edges, in the order in which they are counted."""
        return self.motions, self.positions, self.bearings

    @property
    def edge_count(self) -> int:
        """How many edges there are, of all kinds."""
        return sum(len(edges) for edges in self.kinds)

    def select_edges(self, kept: Flags) -> PoseGraph:
        """The same graph with only those edges for which `kept` (edge_count,) holds."""
        first, second = len(self.motions), len(self.motions) + len(self.positions)
        return replace(
            self,
            motions=self.motions.select(kept[:first]),
            positions=self.positions.select(kept[first:second]),
            bearings=self.bearings.select(kept[second:]),
        )

    def with_estimate(self, poses: Floats, landmarks: Floats) -> PoseGraph:
        """The same graph with its poses (n, 3) and landmarks (m, 2) elsewhere."""
        return replace(self, poses=poses, landmarks=landmarks)
