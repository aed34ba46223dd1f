"""Removal of walls by free-space evidence, and openings of walls that are merged."""

import copy

import numpy as np

from drivers import se2
from slam.geometry.segments import CornerPoints, Segments
from slam.mapping.keyframes import KeyframeMotion, LandmarkIds
from slam.mapping.landmark_table import NEVER_REMOVED
from slam.mapping.landmarks import Landmarks
from slam.mapping.mapper import Mapper
from slam.mapping.wall_removal import FreeSpaceEvidence
from slam.offline.map_merging.transfer import merge_landmarks

# A small room: four walls, and in the middle a wall of the map that is not there
SIDES = np.array([[0.0, -2.0, 0.0], [3.0, 0.0, np.pi / 2], [0.0, 2.0, np.pi], [-3.0, 0.0, -np.pi / 2]])
HALVES = np.array([3.0, 2.0, 3.0, 2.0])
AROUND = np.concatenate(
    [
        se2.transform(s, np.column_stack([np.arange(-h, h, 0.05), np.zeros(int(40 * h))]))
        for s, h in zip(SIDES, HALVES, strict=True)
    ]
)
MIDDLE = np.array([0.0, 0.0, 0.0])


class Room:
    """Landmarks of the room, and scans from below its middle; its sides were first observed by the keyframe `first`."""

    def __init__(self, first: int = 0, observations: int = 9) -> None:
        self.landmarks, self.free_space_evidence, self.travelled = Landmarks(), FreeSpaceEvidence(), [0.0]
        self.wall = self.landmarks.add_wall(MIDDLE, 1.0, 0)
        self.landmarks.walls.rows["observations"][self.wall] = observations
        for side, half in zip(SIDES, HALVES, strict=True):
            self.landmarks.add_wall(side, half, first)

    def scan(self, count: int, *, seen: bool = False, step: float = 0.25) -> None:
        """Drive to and fro and add scans; with `seen`, the wall in the middle is there."""
        for _ in range(count):
            self.travelled.append(self.travelled[-1] + step)
            pose = np.array([abs((self.travelled[-1] + 1.0) % 4.0 - 2.0) - 1.0, -1.3, 0.4])
            middle = np.column_stack([np.arange(-1.0, 1.0, 0.05), np.zeros(40)])
            points = np.concatenate([AROUND, middle]) if seen else AROUND
            covariances = [np.zeros((3, 3))] * len(self.travelled)
            self.free_space_evidence.update(
                self.landmarks, pose, se2.transform(se2.inverse(pose), points), self.travelled, covariances
            )

    @property
    def is_removed(self) -> bool:
        return bool(self.landmarks.walls.rows["removed_at"][self.wall] != NEVER_REMOVED)


def test_a_wall_seen_through_often_enough_is_removed() -> None:
    room = Room()
    room.scan(3)
    assert not room.is_removed
    room.scan(30)
    assert room.is_removed
    assert room.landmarks.active().tolist() == [False, True, True, True, True]
    assert room.wall not in room.landmarks.walls_near(np.array([0.0, 1.0, 0.0]), 5.0)
    assert room.free_space_evidence.counts == {}


def test_walls_with_fewer_observations_are_removed_sooner() -> None:
    needed = []
    for observations in (1, 2, 20):
        room = Room(observations=observations)
        while not room.is_removed:
            room.scan(1)
        needed.append(len(room.travelled))
    assert needed[0] < needed[1] < needed[2]


def test_glass_seen_by_every_fourth_scan_stays() -> None:
    room = Room()
    for _ in range(40):
        room.scan(1, seen=True)
        room.scan(3)
    assert not room.is_removed
    assert not room.landmarks.opened


def test_scans_of_a_standing_robot_do_not_count() -> None:
    room = Room()
    room.scan(100, step=0.0)
    assert not room.is_removed


def test_a_scan_not_supported_by_older_walls_does_not_count() -> None:
    """A robot that has drifted sees the walls that it mapped itself, and sees through older ones."""
    room = Room(first=60)
    room.scan(60, seen=True)  # elsewhere: without evidence about the wall
    room.landmarks.walls.rows["last_seen"][room.wall] = 0
    room.scan(60)
    assert not room.is_removed


def test_suspended_evidence_removes_nothing() -> None:
    room = Room()
    for _ in range(20):
        room.scan(4)
        room.free_space_evidence.suspend(room.travelled[-1])
        assert room.free_space_evidence.counts == {}
    assert not room.is_removed


def test_a_deep_copy_has_its_own_counts() -> None:
    room = Room()
    room.scan(3)
    assert room.free_space_evidence.counts
    other = copy.deepcopy(room)
    other.scan(30)
    assert other.is_removed
    assert not room.is_removed
    assert len(room.landmarks.covered[room.wall]) == 20
    assert room.free_space_evidence.counts


def test_merged_sessions_keep_their_removed_and_opened_walls() -> None:
    first, second = Mapper(), Mapper()
    nothing = Segments(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2)))
    no_corners = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=int), np.zeros((0, 2)))
    no_ids = LandmarkIds(np.zeros(0, dtype=int), np.zeros(0, dtype=int))
    for keyframe in range(50):
        motion = KeyframeMotion(keyframe - 1, np.zeros(3), np.eye(3)) if keyframe else None
        first.add_keyframe_with_ids(np.zeros(3), motion, nothing, no_corners, no_ids)
    for mapper, removed in ((first, 0), (second, 1)):
        for _ in range(2):
            mapper.landmarks.add_wall(MIDDLE, 1.0, 0)
        mapper.landmarks.remove_wall(removed, 7)
        mapper.landmarks.open_wall(1 - removed, [2, 3], 9)
    joined = merge_landmarks(first, second, np.array([1.0, 2.0, 0.3]))
    assert joined.walls.rows["removed_at"].tolist() == [7, NEVER_REMOVED, NEVER_REMOVED, 57]
    assert joined.opened == {1: {2: 9, 3: 9}, 2: {2: 59, 3: 59}}
    assert joined.active().tolist() == [False, True, True, False]
    in_front_of_all = se2.compose(MIDDLE, [0.0, 20.0, 0.0])
    assert joined.walls_near(in_front_of_all, 50.0).tolist() == [1, 2]
    assert joined.walls_near(in_front_of_all, 50.0, keyframe=7).tolist() == [0, 1, 2, 3]
    assert joined.walls_near(in_front_of_all, 50.0, keyframe=57).tolist() == [1, 2, 3]


def test_a_wall_keeps_its_opening_when_it_is_merged() -> None:
    """Whichever of the two was opened; later observations cover the cells again."""
    for opened in (0, 1):
        landmarks = Landmarks()
        landmarks.add_wall(MIDDLE, 1.0, 0)
        landmarks.add_wall(np.array([0.5, 0.0, 0.0]), 1.0, 0)
        shift = 5 * (opened == 1)
        landmarks.open_wall(opened, [cell - shift for cell in (0, 1, 2)], 4)
        landmarks.merge_walls(0, 1)
        assert not landmarks.covered[0] & {0, 1, 2}
        landmarks.observe_wall(0, np.array([0.15, 0.0, 0.0]), 0.06, 4)  # no later than the opening
        assert 1 not in landmarks.covered[0]
        landmarks.observe_wall(0, np.array([0.15, 0.0, 0.0]), 0.06, 5)
        assert landmarks.covered[0] & {0, 1, 2} == {1}
