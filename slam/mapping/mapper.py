"""The map under construction: keyframes and landmarks, as variables of the factor graph and as read back from it."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence

import numpy as np

from drivers import se2

from ..geometry.segments import CornerPoints, Floats, Integers, Segments
from ..graph.factor_graph import FactorGraph
from ..graph.factors import Factor, GraphState
from ..graph.graph_storage import restore_graph
from ..graph.range_bias import RangeBias
from ..odometry.correlated_drift import embed_position_covariance, rotate_covariance
from .data_association import RowAssociation
from .keyframe_covariances import KeyframeCovariances
from .keyframes import (
    KeyframeMotion,
    KeyframeObservations,
    KeyframeRecords,
    LandmarkIds,
    RelativeScanMatch,
    WallMerge,
)
from .landmark_ids import assign_landmark_ids
from .landmarks import Landmarks
from .local_map import LOCAL_MAP_MARGIN, LocalMap, local_map_around
from .mapped_keyframes import MappedKeyframes
from .part_gauge import PartGauge
from .read_back import observed_landmarks, read_back_landmarks
from .unconfirmed_observations import UnconfirmedObservations
from .waiting_keyframes import WaitingKeyframe, WaitingKeyframes
from .wall_merging import find_observed_duplicate
from .wall_removal import FreeSpaceEvidence
from .wall_roughness import WallRoughness

# Points of a keyframe without a scan. Origin: definition.
NO_POINTS = np.zeros((0, 2))


class Mapper(MappedKeyframes):
    """The map under construction. All attributes are read-only to other packages.

    graph                the factor graph
    landmarks            walls and corners as last read back from the graph
    roughness            estimate of the wall roughness
    free_space_evidence  evidence against walls that may no longer exist
    gauge                what holds the group of the last part of the map while it is not connected
    """

    def __init__(
        self,
        landmarks: Landmarks | None = None,
        roughness: WallRoughness | None = None,
        free_space_evidence: FreeSpaceEvidence | None = None,
    ) -> None:
        super().__init__()
        self.graph = FactorGraph()
        self.landmarks = landmarks or Landmarks()
        self.roughness = roughness or WallRoughness()
        self.free_space_evidence = free_space_evidence or FreeSpaceEvidence()
        self.gauge = PartGauge()
        self._unconfirmed = UnconfirmedObservations()
        self._waiting = WaitingKeyframes()

    @classmethod
    def with_landmarks_of(cls, other: Mapper) -> Mapper:
        """Return a mapper without keyframes, with copies of the landmarks and of what was learned about them."""
        landmarks, roughness = copy.deepcopy(other.landmarks), copy.deepcopy(other.roughness)
        mapper = cls(landmarks, roughness, copy.deepcopy(other.free_space_evidence))
        mapper.graph.solver.range_bias = RangeBias(other.graph.range_bias.metres)
        return mapper

    @classmethod
    def from_saved(
        cls,
        graph: GraphState,
        landmarks: Landmarks,
        roughness: WallRoughness,
        free_space_evidence: FreeSpaceEvidence,
        keyframes: KeyframeRecords,
        views: Sequence[tuple[Segments, Floats]],
        unconfirmed_observations: Sequence[Factor],
    ) -> Mapper:
        """Restore a mapper from its saved parts; `views` are the segments and the points (p, 2) of each keyframe.

        Raises MapError if the graph leaves a variable undetermined.
        """
        mapper = cls(landmarks, roughness, free_space_evidence)
        mapper.graph = restore_graph(graph)
        mapper.restore_keyframes(keyframes, [segments for segments, _ in views])
        mapper._waiting = WaitingKeyframes(
            WaitingKeyframe(segments, ids, points)
            for k, ((segments, points), ids) in enumerate(zip(views, mapper.landmark_ids, strict=True))
            if mapper.graph.is_waiting(k)
        )
        mapper._unconfirmed = UnconfirmedObservations.from_factors(unconfirmed_observations)
        return mapper

    @property
    def unconfirmed_observations(self) -> list[Factor]:
        """Observations of landmarks that are not in the graph yet, as factors of kind WALL and CORNER."""
        return self._unconfirmed.factors

    # --- poses

    @property
    def covariances(self) -> KeyframeCovariances:
        """Covariances of the keyframes' poses, alone and relative to each other."""
        return KeyframeCovariances(self)

    def keyframes_near(self, pose: se2.Pose, distance: float, turn: float) -> Integers:
        """Return the connected keyframes within a distance (metres) and turn (radians) of a pose, nearest first."""
        distances = np.hypot(*(self.keyframe_poses[:, :2] - pose[:2]).T)
        near = np.flatnonzero(distances < distance)
        near = near[np.abs(se2.wrap(self.keyframe_poses[near, 2] - pose[2])) < turn]
        near = near[self.landmarks.parts.connected(near)]
        return near[np.argsort(distances[near], kind="stable")]

    # --- adding keyframes

    def add_keyframe(
        self,
        pose: se2.Pose,
        motion: KeyframeMotion | None,
        segments: Segments,
        corners: CornerPoints,
        association: RowAssociation,
        local_map: LocalMap,
        scan_matches: Sequence[RelativeScanMatch] = (),
        points: Floats = NO_POINTS,
    ) -> KeyframeObservations:
        """Add a keyframe; the graph is updated after SOLVE_DISTANCE or SOLVE_TURN.

        pose          [x, y, heading] in the map, from registration; initial value in the graph
        motion        from an earlier keyframe; None for the first
        association   of its segments and corners with rows of `local_map`; unmatched features become landmarks
        scan_matches  with earlier keyframes, by points on no known wall
        points        (p, 2) of its scan, in its frame: walls that it sees through are removed
        """
        keyframe = self.keyframe_count
        wall_count = len(self.landmarks.walls)
        landmark_ids = assign_landmark_ids(
            self.landmarks, keyframe, pose, segments, corners, association, local_map, points
        )
        begins_part = keyframe > 0 and keyframe == self.landmarks.parts.firsts[-1]
        self.add_keyframe_with_ids(pose, motion, segments, corners, landmark_ids, apart=begins_part)
        for scan_match in scan_matches:
            self.add_scan_match(scan_match)
        observations = KeyframeObservations(
            segments,
            corners,
            association.in_landmark_ids(landmark_ids.walls, landmark_ids.corners, local_map),
            landmark_ids.walls[landmark_ids.walls >= wall_count],
        )
        self._waiting.append(WaitingKeyframe(segments, landmark_ids, points))
        self.append_covariance()
        # while the map has unconnected parts, decisions to join them need the covariances of each keyframe
        apart = self.landmarks.parts.apart
        if keyframe == 0 or apart or self._waiting.has_moved_on(self.keyframe_poses, self.travelled):
            self.graph.update()
        return observations

    def add_keyframe_with_ids(
        self,
        pose: se2.Pose,
        motion: KeyframeMotion | None,
        segments: Segments,
        corners: CornerPoints,
        landmark_ids: LandmarkIds,
        *,
        apart: bool = False,
    ) -> None:
        """Add a keyframe whose landmark ids are known. Takes effect with the graph's next update, or with `solve`.

        If `apart`, it is the first one of a part of the map that is not connected; `motion` is kept for later.
        """
        keyframe, correlated_drift = self.keyframe_count, np.zeros((2, 2))
        if motion is None:
            self.graph.add_first_keyframe(pose)
        else:
            correlated_drift = self.correlated_drift[motion.start]
            if apart:
                self.gauge = PartGauge.begin(self.graph, keyframe, pose, motion)
            else:
                own_drift = rotate_covariance(embed_position_covariance(motion.correlated_drift), pose[2])[:2, :2]
                correlated_drift = correlated_drift + own_drift
                self.graph.add_keyframe(keyframe, pose, motion.start, motion.motion, motion.covariance)
        self.append_keyframe(pose, motion, segments, landmark_ids, correlated_drift)
        self._unconfirmed.add(keyframe, segments, corners, landmark_ids, self.roughness.variances)
        self._unconfirmed.move_confirmed(self.graph, self.landmarks, landmark_ids, keyframe, pose)

    def add_scan_match(self, match: RelativeScanMatch) -> None:
        """Add a scan match of the last keyframe with an earlier one. Takes effect with the graph's next update."""
        if match.start_covariance is not None:
            self.graph.add_point_map(match.start, match.start_covariance)
        self.graph.add_scan_match(match.start, self.keyframe_count - 1, match.relative, match.covariance)

    @property
    def is_solved(self) -> bool:
        """True if the graph has been solved with all keyframes."""
        return not len(self._waiting) or not self.graph.is_waiting(self.keyframe_count - 1)

    def refresh(
        self, observations: KeyframeObservations, linked: Integers | None = None
    ) -> tuple[LocalMap, WallMerge | None]:
        """Return the local map of the last keyframe, and the walls merged, if any.

        If the graph was solved, the estimate is read back first. `observations` are those of the last keyframe; for
        `linked` see `local_map_around`.
        """
        if not self.is_solved:
            return self.local_map(observations, linked), None
        observed_walls, _ = observed_landmarks(self._waiting.landmark_ids)
        points = self._waiting.read_back(self)
        local_map = self.local_map(observations, linked)
        merge = find_observed_duplicate(self.landmarks, local_map, observed_walls, self.roughness.variances)
        if merge is not None:
            self.merge_walls(merge.kept, merge.absorbed)
        if self._remove_walls_seen_through_since(points) or merge is not None:
            local_map = self.local_map(observations, linked)
        return local_map, merge

    def solve_waiting(self) -> None:
        """Solve the graph with the keyframes that it has not been solved with yet, if any, and read them back."""
        if not self.is_solved:
            self.graph.update()
            self._remove_walls_seen_through_since(self._waiting.read_back(self))

    def _remove_walls_seen_through_since(self, points: Sequence[Floats]) -> bool:
        """Remove walls that the last keyframes, with `points`, see through. Return True if there were any."""
        removed = False
        for pose, of_scan in zip(self.keyframe_poses[self.keyframe_count - len(points) :], points, strict=True):
            removed |= self.remove_walls_seen_through(pose, of_scan)
        return removed

    def local_map(self, observations: KeyframeObservations, linked: Integers | None = None) -> LocalMap:
        """Return the map around the last keyframe, LOCAL_MAP_MARGIN beyond its own observations."""
        return self.local_map_at(self.pose, LOCAL_MAP_MARGIN + observations.segments.reach(), linked)

    def local_map_at(self, pose: se2.Pose, reach: float, linked: Integers | None = None) -> LocalMap:
        """Return the map within `reach` metres of a pose, with covariances relative to the last keyframe.

        For `linked` see `local_map_around`.
        """
        return local_map_around(self.landmarks, pose, reach, self.pose_covariances, linked)

    # --- parts of the map

    def begin_part(self, *, measured: bool) -> None:
        """Begin a part of the map with the next keyframe: nothing in it is connected with the map so far.

        measured  true if odometry measures the motion to it; that is then the only information on its place
        """
        self.solve_waiting()
        self.gauge.release(self)
        self.landmarks.parts.begin(self.keyframe_count, measured=measured)

    def join_part(self, old: int, motion: se2.Pose, loops: Sequence[Factor]) -> Integers:
        """Move the last part by a `motion` [x, y, heading] in the map, and join it with that of the keyframe `old`.

        loops  factors that connect both

        Returns the keyframes that are moved; see `PartGauge.join`.
        """
        moved = self.gauge.join(self, old, motion, loops)
        self.landmarks.parts.join(old, self.keyframe_count - 1)
        return moved

    # --- correcting the map

    def merge_walls(self, kept: int, absorbed: int) -> None:
        """Merge two walls. Takes effect in the graph with its next update."""
        walls = self.landmarks.walls.rows
        along = float(se2.between(walls["frame"][kept], walls["frame"][absorbed])[0])
        self.graph.add_wall_equality(kept, absorbed, along)
        self.landmarks.merge_walls(kept, absorbed)
        self.free_space_evidence.discard([kept, absorbed])

    def remove_wall_observations(self, since: Mapping[int, int]) -> None:
        """Remove the observations of each of some misassociated walls by keyframes from `since[wall]` on."""
        self.graph.remove_wall_observations(since)
        rows = self.landmarks.walls.rows
        for wall, keyframe in since.items():
            rows["last_seen"][wall] = keyframe - 1

    def remove_walls_seen_through(self, pose: se2.Pose, points: Floats) -> bool:
        """Add the free-space evidence of a scan and remove walls, or open parts of them. Return True if there were any.

        `pose` is at or near the last keyframe; `points` (p, 2) are the scan's, in its frame.
        """
        return self.free_space_evidence.update(self.landmarks, pose, points, self.travelled, self.pose_covariances)

    def count_walls_seen_through(self, pose: se2.Pose, points: Floats) -> None:
        """Add the free-space evidence of a scan between keyframes, whose walls the graph may still wait for."""
        self.free_space_evidence.count(self.landmarks, pose, points, self.travelled, self.pose_covariances)

    def solve(self) -> None:
        """Solve in batch all keyframes added to an empty mapper with `add_keyframe_with_ids`, and read all back.

        Pose covariances are not computed; see `recompute_pose_covariances`.
        """
        self.graph.solve_batch()
        self.read_back()

    # --- reading the estimate back

    def recompute_pose_covariances(self) -> None:
        """Compute `pose_covariances` of all keyframes from the graph, as needed after `solve`."""
        covariances = [
            self.graph.relative_covariances([k], [], []).poses[0] + embed_position_covariance(self.correlated_drift[k])
            for k in range(self.keyframe_count)
        ]
        self.pose_covariances = np.array(covariances).reshape(-1, 3, 3)

    def read_back_all(self) -> None:
        """Read all poses and landmarks, and the last keyframe's covariance, back from the graph."""
        independent = self.graph.relative_covariances([self.keyframe_count - 1], [], []).poses[0]
        self.replace_last_covariances((independent + embed_position_covariance(self.correlated_drift[-1]))[None])
        self.read_back()

    def read_back(self, radius: float | None = None) -> None:
        """Read back the landmarks within `radius` metres of the last keyframe; if None, all landmarks and poses.

        Covariances stay as they are.
        """
        if radius is None:
            self.keyframe_poses = self.graph.keyframe_poses(self.keyframe_count)
        read_back_landmarks(self.landmarks, self.graph, self.pose, radius)
