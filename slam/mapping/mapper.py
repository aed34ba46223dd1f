"""Building the map: keyframes, walls and corners go into the factor graph, and come back as the estimate.

The same rays make a corner and the two lines that meet in it. So that they count once, a corner's factor takes a share
of the information of its two segments, and their factors keep the rest: the sum never exceeds what was measured.
"""

from __future__ import annotations

import copy
from collections import defaultdict, deque
from collections.abc import Sequence

import numpy as np

from drivers import se2

from ..geometry.segments import CornerPoints, Floats, Integers, Segments
from ..graph.backend import FactorGraph
from ..graph.covariances import ROBUST_COVARIANCE_SCALE
from ..graph.factors import Factor, FactorKind, GraphState
from ..odometry.correlated_drift import planar, turned
from .data_association import Association
from .keyframes import KeyframeObservations, KeyframeRecords, LandmarkIds, Merge, Motion
from .landmark_ids import assign_landmark_ids
from .landmarks import Landmarks
from .local_map import LocalMap, local_map_around
from .wall_merging import LEAST_OBSERVATIONS, find_duplicate, merge_everywhere
from .wall_removal import FreeSpaceEvidence
from .wall_roughness import WallRoughness, uneven

CORNER_SHARE = 0.1  # of its segments' information that a corner's factor takes; measured by consistency in simulation
CONFIRMING_KEYFRAMES = 2  # that must see a landmark before it enters the graph: people and noise are seen once
REACH_MARGIN = 2.0  # metres beyond what the keyframe itself saw, within which the map is compared with the next scans
WELL_KNOWN_OBSERVATIONS = 4  # keyframes after which a wall can judge the scatter of what is seen of it
KEPT_VIEWS = 25  # keyframes whose segments are kept for judging loop closures
REFRESH_ALL = 20  # keyframes after which the estimate of every landmark is read back, not only of those around


class Mapper:
    """The map under construction."""

    def __init__(self) -> None:
        self.graph = FactorGraph()
        self.landmarks = Landmarks()
        self.roughness = WallRoughness()
        self.free_space_evidence = FreeSpaceEvidence()
        self.keyframe_count = 0
        self.keyframe_poses: Floats = np.zeros(
            (0, 3)
        )  # the keyframes' poses, those long past as they were lately read back
        self.travelled = [0.0]  # metres driven up to each keyframe
        self.views: deque[tuple[int, Segments]] = deque(maxlen=KEPT_VIEWS)
        self.landmark_ids: list[LandmarkIds] = []  # of each keyframe, as they were when it was added
        self.pose_covariances: list[Floats] = []  # of the keyframes when they were added, (3, 3) in the map's axes
        self.correlated_drift: Floats = np.zeros((0, 2, 2))  # see `adrift.py`; included there
        self._waiting_walls: dict[int, list[tuple[int, se2.Pose, Floats]]] = defaultdict(list)
        self._waiting_corners: dict[int, list[tuple[int, Floats, Floats]]] = defaultdict(list)

    @classmethod
    def on(cls, other: Mapper) -> Mapper:
        """A mapper without keyframes yet, that knows the landmarks of another."""
        mapper = cls()
        mapper.landmarks, mapper.roughness = copy.deepcopy(other.landmarks), copy.deepcopy(other.roughness)
        mapper.free_space_evidence = copy.deepcopy(other.free_space_evidence)
        return mapper

    @classmethod
    def restored(
        cls,
        graph: GraphState,
        landmarks: Landmarks,
        roughness: WallRoughness,
        free_space_evidence: FreeSpaceEvidence,
        keyframes: KeyframeRecords,
        segments: Sequence[Segments],
        waiting: Sequence[Factor],
    ) -> Mapper:
        """The mapper that these were of; `segments` are those of each keyframe.

        Raises MapError where the graph leaves a variable undetermined.
        """
        mapper = cls()
        mapper.graph, mapper.landmarks, mapper.roughness = FactorGraph.restored(graph), landmarks, roughness
        mapper.free_space_evidence = free_space_evidence
        mapper.keyframe_count, mapper.keyframe_poses = len(keyframes.keyframe_poses), keyframes.keyframe_poses
        mapper.travelled, mapper.landmark_ids = list(keyframes.travelled), list(keyframes.landmark_ids)
        mapper.pose_covariances, mapper.correlated_drift = list(keyframes.covariances), keyframes.correlated_drift
        mapper.views.extend(enumerate(segments))
        for factor in waiting:
            seen = factor.first, factor.measured, factor.covariance
            waits = mapper._waiting_walls if factor.kind is FactorKind.WALL else mapper._waiting_corners
            waits[factor.second].append(seen)
        return mapper

    @property
    def waiting(self) -> list[Factor]:
        """What was seen of landmarks that are not in the graph yet."""
        return [
            Factor(kind, keyframe, landmark, measured, covariance)
            for kind, waits in ((FactorKind.WALL, self._waiting_walls), (FactorKind.CORNER, self._waiting_corners))
            for landmark, seen in waits.items()
            for keyframe, measured, covariance in seen
        ]

    @property
    def keyframes(self) -> KeyframeRecords:
        """What is remembered of the keyframes."""
        return KeyframeRecords(
            self.keyframe_poses, self.travelled, self.landmark_ids, self.pose_covariances, self.correlated_drift
        )

    @property
    def pose(self) -> se2.Pose:
        """Of the last keyframe."""
        return np.zeros(3) if not len(self.keyframe_poses) else self.keyframe_poses[-1]

    def last_pose_covariance(self) -> Floats:
        """(3, 3) of the last keyframe's pose, in its own frame: as `keyframe_covariance`, but free."""
        common = planar(self.correlated_drift[-1])
        own = self.pose_covariances[-1] - common
        return turned(ROBUST_COVARIANCE_SCALE * own + common, -self.pose[2])

    def keyframe_covariance(self, keyframe: int) -> Floats:
        """(3, 3): covariance of a keyframe's pose, in the keyframe's own frame (metres, metres, radians)."""
        common = turned(planar(self.correlated_drift[keyframe]), -self.graph.keyframe_pose(keyframe)[2])
        return self.graph.keyframe_covariance(keyframe) + common

    def relative_covariance(self, old: int, keyframe: int) -> Floats:
        """(3, 3): covariance of a keyframe's pose relative to an older one, in its own frame."""
        common = turned(
            planar(self.correlated_drift[keyframe] - self.correlated_drift[old]), -self.graph.keyframe_pose(keyframe)[2]
        )
        return self.graph.relative_covariance(old, keyframe) + common

    def poses_of(self, keyframes: Sequence[int]) -> Floats:
        """(n, 3): the poses of some keyframes as the graph has them now."""
        self.keyframe_poses[list(keyframes)] = self.graph.some_poses(keyframes)
        return self.keyframe_poses[list(keyframes)]

    def keyframes_near(self, pose: se2.Pose, distance: float, turn: float) -> Integers:
        """Keyframes within a distance (metres) and turn (radians) of a pose, the nearest first."""
        apart = np.hypot(*(self.keyframe_poses[:, :2] - pose[:2]).T)
        near = np.flatnonzero((apart < distance) & (np.abs(se2.wrap(self.keyframe_poses[:, 2] - pose[2])) < turn))
        return near[np.argsort(apart[near], kind="stable")]

    def add_keyframe(
        self,
        pose: se2.Pose,
        motion: Motion | None,
        segments: Segments,
        corners: CornerPoints,
        association: Association,
        local_map: LocalMap,
    ) -> KeyframeObservations:
        """A keyframe near `pose`, reached by a motion from an earlier one (None for the first), with what it sees."""
        keyframe = self.keyframe_count
        known = len(self.landmarks.walls)
        landmark_ids = assign_landmark_ids(self.landmarks, keyframe, pose, segments, corners, association, local_map)
        self.extend(pose, motion, segments, corners, landmark_ids)
        self.graph.update()
        self.keyframe_poses[-1] = self.graph.keyframe_pose(keyframe)
        return KeyframeObservations(
            segments,
            corners,
            landmark_ids.walls,
            association.wall_distance,
            _identities(association.nearest_wall, local_map.walls),
            landmark_ids.corners,
            association.corner_distance,
            _identities(association.nearest_corner, local_map.corners),
            landmark_ids.walls[landmark_ids.walls >= known],
        )

    def extend(
        self,
        pose: se2.Pose,
        motion: Motion | None,
        segments: Segments,
        corners: CornerPoints,
        landmark_ids: LandmarkIds,
    ) -> None:
        """Give the graph a keyframe and what it sees, by name; takes effect with the graph's next update."""
        keyframe = self.keyframe_count
        self.keyframe_count += 1
        correlated_drift = np.zeros((2, 2))
        if motion is None:
            self.graph.add_first_keyframe(pose)
        else:
            correlated_drift = (
                self.correlated_drift[motion.start] + turned(planar(motion.correlated_drift), pose[2])[:2, :2]
            )
            self.graph.add_keyframe(keyframe, pose, motion.start, motion.motion, motion.covariance)
            self.travelled.append(self.travelled[-1] + float(np.hypot(motion.motion[0], motion.motion[1])))
        self.keyframe_poses = np.vstack([self.keyframe_poses, pose])
        self.correlated_drift = np.concatenate([self.correlated_drift, correlated_drift[None]])
        self.views.append((keyframe, segments))
        self.landmark_ids.append(landmark_ids)
        self._observe(keyframe, pose, segments, corners, landmark_ids.walls, landmark_ids.corners)

    def _observe(
        self,
        keyframe: int,
        pose: se2.Pose,
        segments: Segments,
        corners: CornerPoints,
        walls: Integers,
        corner_landmarks: Integers,
    ) -> None:
        """Turn what was seen into factors; landmarks that are not confirmed yet keep theirs waiting."""
        shares = np.zeros(len(segments))
        np.add.at(shares, corners.segments[corner_landmarks >= 0], CORNER_SHARE)
        covariances = uneven(segments.covariance, segments.half_length, self.roughness.variance)
        for i in np.flatnonzero(walls >= 0):
            self._waiting_walls[int(walls[i])].append((keyframe, segments.frame[i], covariances[i] / (1 - shares[i])))
        spread = self.roughness.variance * np.eye(2)
        for i in np.flatnonzero(corner_landmarks >= 0):
            covariance = (corners.covariance[i] + spread) / CORNER_SHARE
            self._waiting_corners[int(corner_landmarks[i])].append((keyframe, corners.position[i], covariance))
        for wall in dict.fromkeys(int(w) for w in walls if w >= 0):
            if self.landmarks.walls.rows["observations"][wall] >= CONFIRMING_KEYFRAMES:
                self._send_wall(wall, keyframe, pose)
        for corner in (int(c) for c in corner_landmarks if c >= 0):
            if self.landmarks.corners.rows["observations"][corner] >= CONFIRMING_KEYFRAMES:
                self._send_corner(corner)

    def _send_wall(self, wall: int, keyframe: int, pose: se2.Pose) -> None:
        """Give the graph all waiting observations of a wall."""
        row = self.landmarks.walls.rows[wall]
        for seen_from, frame, covariance in self._waiting_walls.pop(wall):
            viewpoint = pose if seen_from == keyframe else self.graph.keyframe_pose(seen_from)
            believed = se2.between(viewpoint, row["frame"])
            if not row["in_graph"]:
                self.graph.add_wall(seen_from, wall, row["frame"], believed)
                row["in_graph"] = True
            self.graph.observe_wall(seen_from, wall, frame, covariance, believed)

    def _send_corner(self, corner: int) -> None:
        row = self.landmarks.corners.rows[corner]
        if not row["in_graph"]:
            self.graph.add_corner(corner, row["position"])
            row["in_graph"] = True
        for seen_from, position, covariance in self._waiting_corners.pop(corner):
            self.graph.observe_corner(seen_from, corner, position, covariance)

    def refresh(self, view: KeyframeObservations) -> tuple[LocalMap, Merge | None]:
        """Read the estimate back, learn from it, and return the map around the last keyframe, of which `view` is;
        and the walls that turned out to be one, if any."""
        everything = (self.keyframe_count - 1) % REFRESH_ALL == 0
        self._read_back(None if everything else REACH_MARGIN + view.segments.reach())
        self._keep_covariances(view)
        self._learn_roughness(view)
        local_map = self.local_map(view)
        merge = self._merge(local_map, view)
        return self.local_map(view) if merge else local_map, merge

    def local_map(self, view: KeyframeObservations) -> LocalMap:
        """The map around the last keyframe, as far as that keyframe saw and a little farther."""
        return self.local_map_at(self.pose, REACH_MARGIN + view.segments.reach())

    def local_map_at(self, pose: se2.Pose, reach: float) -> LocalMap:
        """The map within `reach` (metres) of a pose, as certain as it is seen from the last keyframe."""
        return local_map_around(self.landmarks, pose, reach, self.pose_covariances)

    def merge_walls(self, kept: int, absorbed: int) -> None:
        """Two walls are one. Takes effect in the graph with its next update."""
        walls = self.landmarks.walls.rows
        along = float(se2.between(walls["frame"][kept], walls["frame"][absorbed])[0])
        self.graph.tie_walls(kept, absorbed, along)
        self.landmarks.absorb(kept, absorbed)
        self.free_space_evidence.settle([kept, absorbed])

    def remove_seen_through(self, pose: se2.Pose, points: Floats) -> bool:
        """Look from `pose`, at or near the last keyframe, at points (p, 2) in its frame, and retire walls that have
        been seen through often enough; returns whether there were any."""
        return self.free_space_evidence.update(self.landmarks, pose, points, self.travelled, self.pose_covariances)

    def settle(self) -> int:
        """Bring the estimate to rest: walls that are one made one wherever they are, everything linearised anew, then
        read back. Returns how many walls were merged."""
        self.read_back_all()
        merged = merge_everywhere(self.landmarks, self.graph, self.roughness.variance, self.merge_walls)
        if merged:
            self.graph.update()
        self.graph.settle()
        self.graph.rebuild()
        self.read_back_all()
        return merged

    def solve(self) -> None:
        """Solve all that an empty mapper was given by `extend`, in batch, and read it back."""
        self.graph.solve()
        self._read_back(None)

    def remember_covariances(self) -> None:
        """Note how well every keyframe is known now. A map that was solved in batch never has."""
        every = range(self.keyframe_count)
        self.pose_covariances = [
            self.graph.relative_covariances(k, [], [])[0] + planar(self.correlated_drift[k]) for k in every
        ]

    def read_back_all(self) -> None:
        """Take the whole estimate from the graph."""
        own = self.graph.relative_covariances(self.keyframe_count - 1, [], []).pose
        self.pose_covariances[-1] = own + planar(self.correlated_drift[-1])
        self._read_back(None)

    def _read_back(self, radius: float | None) -> None:
        """Take from the graph what it knows of the landmarks within `radius` (metres) of the last keyframe, or all."""
        if radius is None:
            self.keyframe_poses = self.graph.keyframe_poses(self.keyframe_count)
        walls, corners = self.landmarks.walls.rows, self.landmarks.corners.rows
        near_walls = np.arange(len(walls)) if radius is None else self.landmarks.walls_near(self.pose, radius)
        near_corners = np.arange(len(corners)) if radius is None else self.landmarks.corners_near(self.pose, radius)
        near_walls = near_walls[walls["in_graph"][near_walls]]
        near_corners = near_corners[corners["in_graph"][near_corners]]
        walls["frame"][near_walls] = self.graph.wall_frames(near_walls)
        corners["position"][near_corners] = self.graph.corner_positions(near_corners)

    def _merge(self, local_map: LocalMap, view: KeyframeObservations) -> Merge | None:
        """Make one of two walls of the local map, if one of them was just seen and they are the same."""
        rows = self.landmarks.walls.rows[local_map.walls]
        mature = rows["in_graph"] & (rows["observations"] >= LEAST_OBSERVATIONS)
        found = find_duplicate(local_map, mature, np.isin(local_map.walls, view.walls), self.roughness.variance)
        if found is None:
            return None
        first, second = int(local_map.walls[found.first]), int(local_map.walls[found.second])
        self.merge_walls(first, second)
        return Merge(first, second, found.distance)

    def _keep_covariances(self, view: KeyframeObservations) -> None:
        """Note how well the landmarks just seen are known from here: right after an update this is cheap to ask."""
        walls, corners = self.landmarks.walls.rows, self.landmarks.corners.rows
        seen_walls = np.unique(view.walls[view.walls >= 0])
        seen_walls = seen_walls[walls["in_graph"][seen_walls]]
        seen_corners = np.unique(view.corner_landmarks[view.corner_landmarks >= 0])
        seen_corners = seen_corners[corners["in_graph"][seen_corners]]
        known = self.graph.relative_covariances(self.keyframe_count - 1, seen_walls, seen_corners)
        walls["covariance"][seen_walls] = known.walls
        walls["covariance_in_map"][seen_walls] = known.walls_in_map
        corners["covariance"][seen_corners] = known.corners
        corners["covariance_in_map"][seen_corners] = known.corners_in_map
        self.pose_covariances.append(known.pose + planar(self.correlated_drift[-1]))

    def _learn_roughness(self, view: KeyframeObservations) -> None:
        """Compare the segments with the walls they were given to, now that the graph has settled both."""
        rows = self.landmarks.walls.rows
        known = np.flatnonzero(view.walls >= 0)
        known = known[rows["observations"][view.walls[known]] >= WELL_KNOWN_OBSERVATIONS]
        if not len(known):
            return
        walls = rows[view.walls[known]]
        seen = se2.between(walls["frame"], se2.compose(self.pose, view.segments.frame[known]))
        self.roughness.add(seen[:, 1:], view.segments.covariance[known], view.segments.half_length[known])


def _identities(rows: Integers, landmarks: Integers) -> Integers:
    """What rows of the local map stand for, -1 for none."""
    return np.where(rows >= 0, landmarks[rows], -1) if len(landmarks) else np.full(len(rows), -1)
