"""Observations of landmarks that are not confirmed yet, kept until they can become factors of the graph."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

import numpy as np

from drivers import se2

from ..geometry.range_bias import corner_bias_slopes
from ..geometry.roughness import Roughness, add_roughness
from ..geometry.segments import CornerPoints, Floats, Segments
from ..graph.factor_graph import FactorGraph
from ..graph.factors import Factor, FactorKind
from .keyframes import LandmarkIds
from .landmarks import Landmarks

# Share of its two segments' information that the factor of a corner takes over.
# Origin: measured, consistency (NEES) of simulated drives: smaller than the value first chosen.
CORNER_SHARE = 0.1
# Keyframes that must observe a landmark before it becomes a variable of the graph: people and noise are observed once.
# Origin: geometry, the fewest that show a landmark to be static.
CONFIRMING_KEYFRAMES = 2


class UnconfirmedObservations:
    """Observations by landmark id.

    Of a wall these are keyframe, frame (3,), covariance (2, 2) of offset and heading, and how both change per metre of
    range bias; of a corner keyframe, position (2,), its covariance (2, 2), and how it changes per metre of range bias.
    """

    def __init__(self) -> None:
        self._walls: dict[int, list[tuple[int, se2.Pose, Floats, Floats]]] = defaultdict(list)
        self._corners: dict[int, list[tuple[int, Floats, Floats, Floats]]] = defaultdict(list)

    @classmethod
    def from_factors(cls, factors: Iterable[Factor]) -> UnconfirmedObservations:
        """Restore a buffer from its `factors`."""
        observations = cls()
        for factor in factors:
            by_landmark = observations._walls if factor.kind is FactorKind.WALL else observations._corners
            by_landmark[factor.second].append((factor.first, factor.measured, factor.covariance, factor.bias_slope))
        return observations

    @property
    def factors(self) -> list[Factor]:
        """The buffered observations as factors of kind WALL and CORNER."""
        return [
            Factor(kind, keyframe, landmark, measured, covariance, slope)
            for kind, by_landmark in ((FactorKind.WALL, self._walls), (FactorKind.CORNER, self._corners))
            for landmark, observations in by_landmark.items()
            for keyframe, measured, covariance, slope in observations
        ]

    def add(
        self, keyframe: int, segments: Segments, corners: CornerPoints, landmark_ids: LandmarkIds, roughness: Roughness
    ) -> None:
        """Add the observations of a keyframe, with the wall roughness added to them.

        The rays that determine a corner also determine the two lines that meet in it. To count them once, the corner
        takes the share CORNER_SHARE of its segments' information, and their own factors keep the rest.
        """
        walls = landmark_ids.walls
        shares = np.zeros(len(segments))
        np.add.at(shares, corners.segments[landmark_ids.corners >= 0], CORNER_SHARE)
        covariances = add_roughness(segments.covariance, segments.half_length, roughness)
        covariances = covariances / (1 - shares)[:, None, None]
        for i, wall in enumerate(walls.tolist()):
            if wall >= 0:
                self._walls[wall].append((keyframe, segments.frame[i], covariances[i], segments.bias_slope[i]))
        if not len(corners):
            return
        slopes = corner_bias_slopes(segments, corners)
        covariances = (corners.covariance + roughness.offset * np.eye(2)) / CORNER_SHARE
        for i, corner in enumerate(landmark_ids.corners.tolist()):
            if corner >= 0:
                self._corners[corner].append((keyframe, corners.position[i], covariances[i], slopes[i]))

    def move_confirmed(
        self, graph: FactorGraph, landmarks: Landmarks, landmark_ids: LandmarkIds, keyframe: int, pose: se2.Pose
    ) -> None:
        """Move the observations of those landmarks that are confirmed now into the graph.

        `landmark_ids` are those that the last `keyframe`, at `pose`, observed.
        """
        for wall in dict.fromkeys(int(w) for w in landmark_ids.walls if w >= 0):
            if landmarks.walls.rows["observations"][wall] >= CONFIRMING_KEYFRAMES:
                self._move_wall(graph, landmarks, wall, keyframe, pose)
        for corner in (int(c) for c in landmark_ids.corners if c >= 0):
            if landmarks.corners.rows["observations"][corner] >= CONFIRMING_KEYFRAMES:
                self._move_corner(graph, landmarks, corner)

    def _move_wall(self, graph: FactorGraph, landmarks: Landmarks, wall: int, keyframe: int, pose: se2.Pose) -> None:
        row = landmarks.walls.rows[wall]
        for observer, frame, covariance, slope in self._walls.pop(wall):
            viewpoint = pose if observer == keyframe else graph.keyframe_pose(observer)
            predicted = se2.between(viewpoint, row["frame"])
            if not row["in_graph"]:
                graph.add_wall(observer, wall, row["frame"], predicted)
                row["in_graph"] = True
            graph.add_wall_observation(observer, wall, frame, covariance, predicted, slope)

    def _move_corner(self, graph: FactorGraph, landmarks: Landmarks, corner: int) -> None:
        row = landmarks.corners.rows[corner]
        if not row["in_graph"]:
            graph.add_corner(corner, row["position"])
            row["in_graph"] = True
        for observer, position, covariance, slope in self._corners.pop(corner):
            graph.add_corner_observation(observer, corner, position, covariance, slope)
