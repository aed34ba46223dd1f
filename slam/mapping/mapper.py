"""The map under construction: keyframes and landmarks, as variables of the factor graph and as read back from it."""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from drivers import se2

from ..geometry.segments import CornerPoints, Floats, Integers, Segments
from ..graph.covariances import ROBUST_COVARIANCE_SCALE
from ..graph.factor_graph import FactorGraph
from ..graph.factors import Factor, GraphState
from ..graph.graph_estimate import Marginals
from ..graph.range_bias import RangeBias
from ..odometry.correlated_drift import embed_position_covariance, rotate_covariance
from .data_association import Association
from .keyframes import KeyframeMotion, KeyframeObservations, KeyframeRecords, LandmarkIds, PointMotion, WallMerge
from .landmark_ids import assign_landmark_ids
from .landmarks import Landmarks
from .local_map import LocalMap, local_map_around
from .part_gauge import PartGauge
from .read_back import read_back_covariances, read_back_landmarks
from .unconfirmed_observations import UnconfirmedObservations
from .wall_merging import find_observed_duplicate, merge_duplicate_walls
from .wall_removal import FreeSpaceEvidence
from .wall_roughness import WallRoughness
from .wall_splitting import find_splits, split_landmark, with_new_walls

# Metres by which the local map reaches beyond what the last keyframe observed; the next scans are matched to it.
# Origin: chosen, several times the distance between keyframes; not measured.
LOCAL_MAP_MARGIN = 2.0
# Keyframes whose segments are kept for verifying loop closures. Origin: chosen, some 8 m of driving; not measured.
MAX_RECENT_SEGMENTS = 25
# Keyframes after which the estimate of all landmarks is read back, not only of those nearby.
# Origin: chosen, the cost of reading all back becomes negligible; not measured.
FULL_READ_BACK_INTERVAL = 20


class Mapper:
    """The map under construction. All attributes are read-only to other modules.

    graph                the factor graph
    landmarks            walls and corners as last read back from the graph
    roughness            estimate of the wall roughness
    free_space_evidence  evidence against walls that may no longer exist
    keyframe_count       number of keyframes, k
    keyframe_poses       (k, 3) in the map, as last read back: older ones only every FULL_READ_BACK_INTERVAL keyframes
    travelled            metres driven up to each keyframe; [0.0] before the first
    recent_segments      index and segments of the last MAX_RECENT_SEGMENTS keyframes
    landmark_ids         of each keyframe, as assigned when it was added
    pose_covariances     (3, 3) of each keyframe when it was added, in the map's axes, correlated drift included
    correlated_drift     (k, 2, 2) accumulated up to each keyframe, in the map's axes; see `slam.odometry`
    gauge                what holds the group of the last part of the map while it is not connected
    """

    def __init__(
        self,
        landmarks: Landmarks | None = None,
        roughness: WallRoughness | None = None,
        free_space_evidence: FreeSpaceEvidence | None = None,
    ) -> None:
        self.graph = FactorGraph()
        self.landmarks = landmarks or Landmarks()
        self.roughness = roughness or WallRoughness()
        self.free_space_evidence = free_space_evidence or FreeSpaceEvidence()
        self.keyframe_count = 0
        self.keyframe_poses: Floats = np.zeros((0, 3))
        self.travelled = [0.0]
        self.recent_segments: deque[tuple[int, Segments]] = deque(maxlen=MAX_RECENT_SEGMENTS)
        self.landmark_ids: list[LandmarkIds] = []
        self.pose_covariances: list[Floats] = []
        self.correlated_drift: Floats = np.zeros((0, 2, 2))
        self.gauge = PartGauge()
        self._unconfirmed = UnconfirmedObservations()

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
        segments: Sequence[Segments],
        unconfirmed_observations: Sequence[Factor],
    ) -> Mapper:
        """Restore a mapper from its saved parts; `segments` are those of each keyframe.

        Raises MapError if the graph leaves a variable undetermined.
        """
        mapper = cls(landmarks, roughness, free_space_evidence)
        mapper.graph = FactorGraph.from_state(graph)
        mapper.keyframe_count, mapper.keyframe_poses = len(keyframes.keyframe_poses), keyframes.keyframe_poses
        mapper.travelled, mapper.landmark_ids = list(keyframes.travelled), list(keyframes.landmark_ids)
        mapper.pose_covariances, mapper.correlated_drift = list(keyframes.covariances), keyframes.correlated_drift
        mapper.recent_segments.extend(enumerate(segments))
        mapper._unconfirmed = UnconfirmedObservations.from_factors(unconfirmed_observations)
        return mapper

    @property
    def unconfirmed_observations(self) -> list[Factor]:
        """Observations of landmarks that are not in the graph yet, as factors of kind WALL and CORNER."""
        return self._unconfirmed.factors

    @property
    def keyframe_records(self) -> KeyframeRecords:
        """Data of the keyframes that must be saved besides the graph."""
        return KeyframeRecords(
            self.keyframe_poses, self.travelled, self.landmark_ids, self.pose_covariances, self.correlated_drift
        )

    # --- poses and covariances

    @property
    def pose(self) -> se2.Pose:
        """Pose of the last keyframe in the map; zero before the first."""
        return np.zeros(3) if not len(self.keyframe_poses) else self.keyframe_poses[-1]

    def last_pose_covariance(self) -> Floats:
        """Return (3, 3) the covariance of the last keyframe's pose, in its own frame.

        As `keyframe_covariance`, but from the stored covariance, so it costs nothing.
        """
        correlated = embed_position_covariance(self.correlated_drift[-1])
        independent = self.pose_covariances[-1] - correlated
        return rotate_covariance(ROBUST_COVARIANCE_SCALE * independent + correlated, -self.pose[2])

    def keyframe_covariance(self, keyframe: int) -> Floats:
        """Return (3, 3) the covariance of a keyframe's pose, in its own frame (metres, metres, radians)."""
        correlated = embed_position_covariance(self.correlated_drift[keyframe])
        heading = self.graph.keyframe_pose(keyframe)[2]
        return self.graph.keyframe_covariance(keyframe) + rotate_covariance(correlated, -heading)

    def keyframe_covariances(self, marginals: Marginals) -> Floats:
        """Return (k, 3, 3) those of all keyframes, given the marginals of the graph."""
        correlated = [embed_position_covariance(drift) for drift in self.correlated_drift]
        headings = self.graph.keyframe_poses(self.keyframe_count)[:, 2].tolist()
        turned = [rotate_covariance(drift, -heading) for drift, heading in zip(correlated, headings, strict=True)]
        return marginals.keyframes(range(self.keyframe_count)) + np.array(turned).reshape(-1, 3, 3)

    def relative_covariance(self, old: int, keyframe: int) -> Floats:
        """Return (3, 3) the covariance of a keyframe's pose relative to an older one, in its own frame."""
        if self.gauge.separates(self, old, keyframe):
            return self.gauge.covariance_across(self, old, keyframe)
        return self.relative_covariance_in_graph(old, keyframe)

    def relative_covariance_in_graph(self, old: int, keyframe: int) -> Floats:
        """Return the covariance as `relative_covariance` does, of keyframes that factors of the graph connect."""
        correlated = embed_position_covariance(self.correlated_drift[keyframe] - self.correlated_drift[old])
        heading = self.graph.keyframe_pose(keyframe)[2]
        return self.graph.relative_covariance(old, keyframe) + rotate_covariance(correlated, -heading)

    def relative_covariance_bound(self, old: int, keyframe: int, *, stored: bool) -> Floats:
        """Return (3, 3) an upper bound of `relative_covariance`, which takes much less time.

        The difference of two errors a and b has a covariance of at most 2 (Cov a + Cov b), whatever their correlation.
        Those of parts of the map that are not connected have different gauges: there it is exact.

        stored  take the covariances from when the keyframes were added, which costs nothing; else the present ones
        """
        if self.gauge.separates(self, old, keyframe):
            return self.gauge.covariance_across(self, old, keyframe)
        heading = self.keyframe_poses[keyframe, 2]
        if stored:
            of_old, of_keyframe = (rotate_covariance(self.pose_covariances[k], -heading) for k in (old, keyframe))
        else:
            own = [(k, float(self.keyframe_poses[k, 2]) - heading) for k in (old, keyframe)]
            of_old, of_keyframe = (rotate_covariance(self.keyframe_covariance(k), turn) for k, turn in own)
        lever = se2.between(self.keyframe_poses[keyframe], self.keyframe_poses[old])
        adjoint = se2.adjoint(np.array([lever[0], lever[1], 0.0]))  # both are in the axes of the keyframe
        return np.asarray(2.0 * (adjoint @ of_old @ adjoint.T + of_keyframe))

    def keyframes_near(self, pose: se2.Pose, distance: float, turn: float) -> Integers:
        """Return the connected keyframes within a distance (metres) and turn (radians) of a pose, nearest first."""
        distances = np.hypot(*(self.keyframe_poses[:, :2] - pose[:2]).T)
        near = np.flatnonzero((distances < distance) & (np.abs(se2.wrap(self.keyframe_poses[:, 2] - pose[2])) < turn))
        near = near[self.landmarks.parts.connected(near)]
        return near[np.argsort(distances[near], kind="stable")]

    # --- adding keyframes

    def add_keyframe(
        self,
        pose: se2.Pose,
        motion: KeyframeMotion | None,
        segments: Segments,
        corners: CornerPoints,
        association: Association,
        local_map: LocalMap,
        point_motion: PointMotion | None = None,
    ) -> KeyframeObservations:
        """Add a keyframe near `pose` and update the graph.

        motion        from an earlier keyframe; None for the first
        association   of its segments and corners with rows of `local_map`; unmatched features become landmarks
        point_motion  from an earlier keyframe, by points on no known wall; None if there is no such keyframe
        """
        keyframe = self.keyframe_count
        wall_count = len(self.landmarks.walls)
        landmark_ids = assign_landmark_ids(self.landmarks, keyframe, pose, segments, corners, association, local_map)
        apart = keyframe > 0 and keyframe == self.landmarks.parts.firsts[-1]
        self.add_keyframe_with_ids(pose, motion, segments, corners, landmark_ids, apart=apart)
        if point_motion is not None:
            self.graph.add_point_map(point_motion.start, point_motion.start_covariance)
            self.graph.add_scan_match(point_motion.start, keyframe, point_motion.relative, point_motion.covariance)
        self.graph.update()
        self.keyframe_poses[-1] = self.graph.keyframe_pose(keyframe)
        return KeyframeObservations(
            segments,
            corners,
            association.in_landmark_ids(landmark_ids.walls, landmark_ids.corners, local_map),
            landmark_ids.walls[landmark_ids.walls >= wall_count],
        )

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
        keyframe = self.keyframe_count
        self.keyframe_count += 1
        correlated_drift = np.zeros((2, 2))
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
            self.travelled.append(self.travelled[-1] + float(np.hypot(motion.motion[0], motion.motion[1])))
        self.keyframe_poses = np.vstack([self.keyframe_poses, pose])
        self.correlated_drift = np.concatenate([self.correlated_drift, correlated_drift[None]])
        self.recent_segments.append((keyframe, segments))
        self.landmark_ids.append(landmark_ids)
        self._unconfirmed.add(keyframe, segments, corners, landmark_ids, self.roughness.variance)
        self._unconfirmed.move_confirmed(self.graph, self.landmarks, landmark_ids, keyframe, pose)

    def refresh(self, observations: KeyframeObservations) -> tuple[LocalMap, WallMerge | None]:
        """Read the estimate back after the last keyframe and return its local map, and the walls merged, if any.

        `observations` are those of the last keyframe: they also update the wall roughness.
        """
        everything = (self.keyframe_count - 1) % FULL_READ_BACK_INTERVAL == 0
        self._read_back(None if everything else LOCAL_MAP_MARGIN + observations.segments.reach())
        independent = read_back_covariances(self.landmarks, self.graph, self.keyframe_count - 1, observations)
        self.pose_covariances.append(independent + embed_position_covariance(self.correlated_drift[-1]))
        self.roughness.add_observations(self.landmarks.walls.rows, self.pose, observations)
        local_map = self.local_map(observations)
        merge = find_observed_duplicate(self.landmarks, local_map, observations, self.roughness.variance)
        if merge is None:
            return local_map, None
        self.merge_walls(merge.kept, merge.absorbed)
        return self.local_map(observations), merge

    def local_map(self, observations: KeyframeObservations) -> LocalMap:
        """Return the map around the last keyframe, LOCAL_MAP_MARGIN beyond its own observations."""
        return self.local_map_at(self.pose, LOCAL_MAP_MARGIN + observations.segments.reach())

    def local_map_at(self, pose: se2.Pose, reach: float) -> LocalMap:
        """Return the map within `reach` metres of a pose, with covariances relative to the last keyframe."""
        return local_map_around(self.landmarks, pose, reach, self.pose_covariances)

    # --- parts of the map

    def begin_part(self, *, measured: bool) -> None:
        """Begin a part of the map with the next keyframe: nothing in it is connected with the map so far.

        measured  true if odometry measures the motion to it; that is then the only information on its place
        """
        self.gauge.release(self)
        self.landmarks.parts.begin(self.keyframe_count, measured=measured)

    def join_part(self, old: int, motion: se2.Pose) -> None:
        """Move the last part by a `motion` [x, y, heading] in the map, and join it with that of the keyframe `old`."""
        self.gauge.join(self, old, motion)
        self.landmarks.parts.join(old, self.keyframe_count - 1)

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

    def converge(self) -> int:
        """Merge duplicate walls of the whole map, split those that are two, iterate to convergence, and read all back.

        A part of the map that is not connected is held by odometry from then on.

        Return the number of walls merged.
        """
        self.gauge.release(self)
        self.graph.update_until_converged()
        self.settle_range_bias()  # before merging: iSAM2 leaves out small steps, and walls are merged where they are
        merged = merge_duplicate_walls(self.landmarks, self.graph, self.roughness.variance, self.merge_walls)
        if merged:
            self.graph.update()
            self.graph.update_until_converged()
            self._read_back(None)
        self.split_walls()
        self.graph.correlate_wall_errors()
        self.settle_range_bias()
        self.read_back_all()
        return merged

    def settle_range_bias(self) -> None:
        """Estimate the range bias together with the graph, which has converged, and read all back."""
        self.graph.settle_range_bias()
        self._read_back(None)

    def split_walls(self) -> int:
        """Split walls whose stretches are different surfaces, and return the number of new walls.

        The estimate has converged and is read back, before and afterwards.
        """
        splits = find_splits(self.landmarks, self.graph, self.keyframe_poses, self.roughness.variance)
        moves = [(split_landmark(self.landmarks, split), split.frame, split.segments) for split in splits]
        if not moves:
            return 0
        self.graph.move_wall_segments(moves)
        self.graph.update_until_converged()
        self.landmark_ids = with_new_walls(self.landmark_ids, moves)
        for wall, _, _ in moves:
            last_seen = int(self.landmarks.walls.rows["last_seen"][wall])
            covariances = self.graph.relative_covariances(last_seen, [wall], [])
            self.landmarks.set_wall_covariances(np.array([wall]), covariances.walls, covariances.walls_in_map)
        self.free_space_evidence.discard([split.wall for split in splits])
        self._read_back(None)
        return len(moves)

    def solve(self) -> list[int]:
        """Solve in batch all keyframes added to an empty mapper with `add_keyframe_with_ids`, and read all back.

        Returns the numbers of the graph's factors, in the order in which they were added. Pose covariances are not
        computed; see `recompute_pose_covariances`.
        """
        numbers = self.graph.solve_batch()
        self._read_back(None)
        return numbers

    # --- reading the estimate back

    def recompute_pose_covariances(self) -> None:
        """Compute `pose_covariances` of all keyframes from the graph, as needed after `solve`."""
        self.pose_covariances = [
            self.graph.relative_covariances(k, [], [])[0] + embed_position_covariance(self.correlated_drift[k])
            for k in range(self.keyframe_count)
        ]

    def read_back_all(self) -> None:
        """Read all poses and landmarks, and the last keyframe's covariance, back from the graph."""
        independent = self.graph.relative_covariances(self.keyframe_count - 1, [], []).pose
        self.pose_covariances[-1] = independent + embed_position_covariance(self.correlated_drift[-1])
        self._read_back(None)

    def _read_back(self, radius: float | None) -> None:
        """Read back the landmarks within `radius` metres of the last keyframe; if None, all landmarks and poses."""
        if radius is None:
            self.keyframe_poses = self.graph.keyframe_poses(self.keyframe_count)
        read_back_landmarks(self.landmarks, self.graph, self.pose, radius)
