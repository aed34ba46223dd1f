"""What is no longer where it was leaves the map, what still is there stays, and who stood somewhere is no wall."""

import copy
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import se2
from drivers.messages import Message
from drivers.simulation import LidarModel, Simulation, TemporaryShapes, World
from slam import Slam
from slam.config import Config, config_to_toml
from slam.events import Finished, MapWalls, WallsRemoved
from slam.io.output_dir import CONFIG
from slam.io.sessions import StoredSession, read_session, write_session
from slam.mapping.landmark_table import NEVER_REMOVED
from slam.mapping.landmarks import WALL_CELL, Landmarks
from slam.mapping.mapper import Mapper
from slam.mapping.sight_lines import MIN_CROSSING_SINE, MIN_DEPTH, ON_WALL_DISTANCE, trace_sight_lines
from slam.mapping.wall_removal import FreeSpaceEvidence
from slam.offline.map_merging.transfer import merge_landmarks

from ..listeners import EventCollector

LIDAR = LidarModel(beams=360)
NOTHING = np.zeros((0, 4)), np.zeros((0, 3))
PATH = np.array([[1.2, 1.2], [6.8, 1.2], [6.8, 4.8], [1.2, 4.8], [1.2, 1.4], [6.5, 1.4]])
START = np.array([1.2, 1.2, 0.0])  # of that path: the map's frame in the world


def box(x: float, y: float, width: float, depth: float) -> list[list[float]]:
    """Four sides around a middle."""
    ends = [(x - width / 2, y - depth / 2), (x + width / 2, y - depth / 2)]
    ends += [(x + width / 2, y + depth / 2), (x - width / 2, y + depth / 2)]
    return [[*a, *b] for a, b in zip(ends, ends[1:] + ends[:1], strict=True)]


ROOM = np.array([*box(4.0, 3.0, 8.0, 6.0), *box(7.6, 5.8, 0.8, 0.4), *box(0.25, 0.2, 0.5, 0.4)])
PARTITION = np.array(box(4.0, 3.0, 3.0, 0.1))


def world(*, always: np.ndarray = ROOM, passing: Sequence[TemporaryShapes] = ()) -> World:
    return World("room", "a room", always, np.zeros((0, 3)), PATH, 0.7, tuple(passing))


def drive(place: World, seed: int = 0, shift: float = 0.0, duration: float | None = None) -> list[Message]:
    messages = Simulation(place, seed=seed, lidar=LIDAR, duration=duration)
    return [replace(message, stamp=message.stamp + shift) for message in messages]


def run(
    messages: Sequence[Message],
    resumed: StoredSession | None = None,
    *,
    refine: bool = False,
    sinks: Sequence[EventCollector] = (),
) -> tuple[Slam, Finished]:
    slam = Slam(resumed=resumed, refine=refine, sinks=sinks)
    for message in messages:
        slam.add(message)
    return slam, slam.finish()


def leave(session: StoredSession, directory: Path) -> Path:
    directory.mkdir()
    (directory / CONFIG).write_text(config_to_toml(Config()))
    write_session(directory, session)
    return directory


def length_on(lines: MapWalls, segments: np.ndarray, within: float = 0.1) -> float:
    """Metres of the map's walls that lie on some segments of the world."""
    points, _ = lines.piece_points()
    total = 0.0
    for start, end in points:
        count = max(1, round(float(np.hypot(*(end - start))) / 0.05))
        parts = ((np.arange(count) + 0.5) / count)[:, None]
        for place in se2.transform(START, start + parts * (end - start)).reshape(-1, 2):
            begin, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
            at = np.clip(np.sum((place - begin) * along, axis=1) / np.sum(along**2, axis=1), 0.0, 1.0)
            total += 0.05 * (np.hypot(*(begin + at[:, None] * along - place).T).min() < within)
    return total


# --- one look


@settings(deadline=None)
@given(
    frame=st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-np.pi, np.pi)),
    heading=st.floats(-np.pi, np.pi),
    cell=st.integers(-9, 9),
    sine=st.floats(MIN_CROSSING_SINE + 0.01, 1.0),
    backwards=st.booleans(),
    before=st.floats(MIN_DEPTH + 0.01, 8.0),
    behind=st.floats(MIN_DEPTH + 0.01, 8.0),
    side=st.sampled_from([-1.0, 1.0]),
)
def test_a_sight_line_opens_the_cell_it_goes_through(
    frame: Sequence[float],
    heading: float,
    cell: int,
    sine: float,
    backwards: bool,
    before: float,
    behind: float,
    side: float,
) -> None:
    """Wherever wall and robot are, from either side; the nearer end tells how deep."""
    along = WALL_CELL * (cell + 0.5)
    slope = np.sqrt(1.0 - sine**2) / sine * (-1.0 if backwards else 1.0)
    eye, point = [along - slope * before, side * before], [along + slope * behind, -side * behind]
    seen, depth, length = look_at(frame, heading, eye, [point])
    assert not seen.any()
    assert length == 0.0
    assert np.flatnonzero(depth).tolist() == [cell + 10]
    assert depth[cell + 10] == pytest.approx(min(before, behind))
    on_it = [along, 0.9 * ON_WALL_DISTANCE]
    seen, depth, length = look_at(frame, heading, eye, [point, on_it])  # what is seen is not seen through
    assert np.flatnonzero(seen).tolist() == [cell + 10]
    assert not depth.any()
    assert length == pytest.approx(WALL_CELL)


@pytest.mark.parametrize(
    ("eye", "point"),
    [
        ([0.05, 2.0], [0.05, 0.5]),  # ends before the wall
        ([0.05, 2.0], [0.05, -0.9 * MIN_DEPTH]),  # too close behind it
        ([0.05, 0.9 * MIN_DEPTH], [0.05, -2.0]),  # the robot stands in it
        ([-4.0, 2.0], [4.1, -2.0]),  # at a grazing angle
        ([1.15, 2.0], [1.15, -2.0]),  # passes it by
    ],
)
def test_what_tells_nothing(eye: Sequence[float], point: Sequence[float]) -> None:
    seen, depth, _ = look_at([3.0, -2.0, 0.7], 0.3, eye, [point])
    assert not seen.any()
    assert not depth.any()


def look_at(
    frame: Sequence[float], heading: float, eye: Sequence[float], points: Sequence[Sequence[float]]
) -> tuple[np.ndarray, np.ndarray, float]:
    """A look at a wall from -1 m to 1 m, given the robot and points in the wall's frame."""
    pose = se2.compose(np.array(frame), np.array([*eye, heading]))
    seen_as = se2.transform(se2.inverse(np.array([*eye, heading])), np.array(points)).reshape(-1, 2)
    seen, depth, length = trace_sight_lines(pose, seen_as, np.array([frame]), np.array([-10]), np.array([0, 20]))
    return seen, depth, float(length[0])


# --- many looks, in a small room: four walls, and one in the middle that is not there

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
    """Its landmarks, and looks from below the middle wall; the sides are known since the keyframe `first`."""

    def __init__(self, first: int = 0, observations: int = 9) -> None:
        self.landmarks, self.free_space_evidence, self.ways = Landmarks(), FreeSpaceEvidence(), [0.0]
        self.wall = self.landmarks.add_wall(MIDDLE, 1.0, 0)
        self.landmarks.walls.rows["observations"][self.wall] = observations
        for side, half in zip(SIDES, HALVES, strict=True):
            self.landmarks.add_wall(side, half, first)

    def look(self, count: int, *, seen: bool = False, step: float = 0.25) -> None:
        """Drive to and fro and look; `seen` is whether the wall in the middle is."""
        for _ in range(count):
            self.ways.append(self.ways[-1] + step)
            pose = np.array([abs((self.ways[-1] + 1.0) % 4.0 - 2.0) - 1.0, -1.3, 0.4])
            middle = np.column_stack([np.arange(-1.0, 1.0, 0.05), np.zeros(40)])
            points = np.concatenate([AROUND, middle]) if seen else AROUND
            covariances = [np.zeros((3, 3))] * len(self.ways)
            self.free_space_evidence.update(
                self.landmarks, pose, se2.transform(se2.inverse(pose), points), self.ways, covariances
            )

    @property
    def retired(self) -> bool:
        return bool(self.landmarks.walls.rows["removed_at"][self.wall] != NEVER_REMOVED)


def test_a_wall_is_retired_that_is_seen_through_often_enough() -> None:
    room = Room()
    room.look(3)
    assert not room.retired
    room.look(30)
    assert room.retired
    assert room.landmarks.active().tolist() == [False, True, True, True, True]
    assert room.wall not in room.landmarks.walls_near(np.array([0.0, 1.0, 0.0]), 5.0)
    assert room.free_space_evidence.counts == {}


def test_what_was_seen_less_often_is_retired_sooner() -> None:
    needed = []
    for observations in (1, 2, 20):
        room = Room(observations=observations)
        while not room.retired:
            room.look(1)
        needed.append(len(room.ways))
    assert needed[0] < needed[1] < needed[2]


def test_glass_stays() -> None:
    """What some looks see, and more of them see through."""
    room = Room()
    for _ in range(40):
        room.look(1, seen=True)
        room.look(3)
    assert not room.retired
    assert not room.landmarks.opened


def test_a_robot_that_stands_sees_nothing_new() -> None:
    room = Room()
    room.look(100, step=0.0)
    assert not room.retired


def test_a_look_that_is_not_held_by_what_was_known_then_does_not_count() -> None:
    """A robot that has drifted sees walls of its own making where they are, and through those of old."""
    room = Room(first=60)
    room.look(60, seen=True)  # far from there: nothing of it was looked at
    room.landmarks.walls.rows["last_seen"][room.wall] = 0
    room.look(60)
    assert not room.retired


def test_nothing_counts_while_the_robot_may_be_elsewhere() -> None:
    room = Room()
    for _ in range(20):
        room.look(4)
        room.free_space_evidence.suspend(room.ways[-1])
        assert room.free_space_evidence.counts == {}
    assert not room.retired


def test_what_is_counted_is_part_of_a_copy() -> None:
    room = Room()
    room.look(3)
    assert room.free_space_evidence.counts
    other = copy.deepcopy(room)
    other.look(30)
    assert other.retired
    assert not room.retired
    assert len(room.landmarks.covered[room.wall]) == 20
    assert room.free_space_evidence.counts


# --- drives


@pytest.fixture(scope="module")
def furnished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The session of a drive through a room with a partition."""
    slam, finished = run(drive(world(always=np.concatenate([ROOM, PARTITION]))))
    assert length_on(finished.lines, PARTITION) > 5.5
    assert finished.summary["removed_walls"] == 0
    return leave(slam.session, tmp_path_factory.mktemp("run") / "out")


@pytest.mark.parametrize("refine", [False, True])
def test_a_partition_that_was_taken_out_leaves_the_map_and_stays_in_the_session(
    furnished: Path, tmp_path: Path, refine: bool
) -> None:
    before = read_session(furnished).slam_state.mapper
    listener = EventCollector()
    slam, finished = run(drive(world(), seed=1, shift=1000.0), read_session(furnished), refine=refine, sinks=[listener])
    removed = [wall for event in listener.of(WallsRemoved) for wall in event.lines]
    assert sorted(removed) == slam.slam_state.mapper.landmarks.removed_walls().tolist()
    assert length_on(finished.lines, PARTITION) == 0.0
    assert length_on(finished.lines, ROOM) > 28.0
    assert finished.summary["removed_walls"] == 2  # its long sides
    again = read_session(leave(slam.session, tmp_path / "out")).slam_state.mapper
    for landmarks in (slam.slam_state.mapper.landmarks, again.landmarks):
        rows = landmarks.walls.rows[landmarks.removed_walls()]
        assert (rows["removed_at"] >= before.keyframe_count).all()
        assert (rows["observations"] > 5).all()
        assert (rows["last_seen"] < before.keyframe_count).all()
        known = [
            len(landmarks.covered[wall]) + len(landmarks.opened.get(wall, ())) for wall in landmarks.removed_walls()
        ]
        assert WALL_CELL * min(known) > 2.5
    assert again.landmarks.opened == slam.session.slam_state.mapper.landmarks.opened


def test_what_is_still_there_stays(furnished: Path) -> None:
    same = world(always=np.concatenate([ROOM, PARTITION]))
    _, finished = run(drive(same, seed=2, shift=1000.0), read_session(furnished))
    assert length_on(finished.lines, PARTITION) > 5.5
    assert finished.summary["removed_walls"] == 0


def test_a_door_that_is_opened_opens_the_wall(furnished: Path) -> None:
    """A stretch in the middle of the partition is gone, the rest is there; a second look at everything knows that."""
    halves = np.array([*box(3.0, 3.0, 1.0, 0.1), *box(5.0, 3.0, 1.0, 0.1)])
    gap = np.array([[3.7, 3.05, 4.3, 3.05], [3.7, 2.95, 4.3, 2.95]])
    place = world(always=np.concatenate([ROOM, halves]))
    slam, finished = run(drive(place, seed=1, shift=1000.0), read_session(furnished), refine=True)
    assert slam.slam_state.mapper.landmarks.opened
    assert length_on(finished.lines, gap, 0.03) < 0.15
    assert length_on(finished.lines, halves) > 3.5
    assert finished.summary["removed_walls"] == 0


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 8))])
def test_who_stands_there_for_some_seconds_is_no_wall_in_the_end(seed: int) -> None:
    person = np.array(box(4.0, 3.0, 0.45, 0.3))
    slam, finished = run(drive(world(passing=[TemporaryShapes(0.0, 7.0, person, NOTHING[1])]), seed))
    assert len(slam.slam_state.mapper.landmarks.removed_walls())  # it had become one
    assert length_on(finished.lines, person) == 0.0
    assert length_on(finished.lines, ROOM) > 28.0


def test_a_door_that_stood_half_open_is_no_wall_in_the_end() -> None:
    leaf = np.array([[4.0, 3.0, 4.6, 3.6]])
    away = np.array([[4.2, 3.2, 4.6, 3.6]])  # from the hinge
    closed = np.array([[4.0, 3.0, 4.85, 3.0]])
    passing = [TemporaryShapes(0.0, 9.0, leaf, NOTHING[1]), TemporaryShapes(9.0, 99.0, closed, NOTHING[1])]
    slam, finished = run(drive(world(passing=passing)))
    assert len(slam.slam_state.mapper.landmarks.removed_walls())
    assert length_on(finished.lines, away) == 0.0
    assert length_on(finished.lines, closed) > 0.6


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_in_a_building_that_does_not_change_nothing_is_retired(seed: int) -> None:
    """Twice around an office; that segments reach across doors at times is found out."""
    _, finished = run(list(Simulation("office", seed=seed)))
    assert finished.summary["removed_walls"] == 0


def test_what_was_counted_is_gone_on_from(tmp_path: Path) -> None:
    partition = TemporaryShapes(0.0, 16.0, PARTITION, NOTHING[1])
    slam, _ = run(drive(world(passing=[partition]), duration=18.0))
    free_space_evidence = slam.session.slam_state.mapper.free_space_evidence
    assert free_space_evidence.counts
    again = read_session(leave(slam.session, tmp_path / "out"))
    assert again.slam_state.mapper.free_space_evidence.counts == {
        wall: cells for wall, cells in free_space_evidence.counts.items() if cells
    }


def test_of_two_sessions_each_keeps_what_was_gone_in_it() -> None:
    first, second = Mapper(), Mapper()
    first.keyframe_count = 50
    for mapper, retired in ((first, 0), (second, 1)):
        for _ in range(2):
            mapper.landmarks.add_wall(MIDDLE, 1.0, 0)
        mapper.landmarks.remove_wall(retired, 7)
        mapper.landmarks.open_wall(1 - retired, [2, 3], 9)
    joined = merge_landmarks(first, second, np.array([1.0, 2.0, 0.3]))
    assert joined.walls.rows["removed_at"].tolist() == [7, NEVER_REMOVED, NEVER_REMOVED, 57]
    assert joined.opened == {1: {2: 9, 3: 9}, 2: {2: 59, 3: 59}}
    assert joined.active().tolist() == [False, True, True, False]
    assert joined.active(keyframe=7).tolist() == [True, True, True, True]
    assert joined.active(keyframe=57).tolist() == [False, True, True, True]


def test_a_wall_keeps_its_opening_when_another_turns_out_to_be_it() -> None:
    """Whichever of the two it was that was opened; and what was seen since is there."""
    for opened in (0, 1):
        landmarks = Landmarks()
        landmarks.add_wall(MIDDLE, 1.0, 0)
        landmarks.add_wall(np.array([0.5, 0.0, 0.0]), 1.0, 0)
        shift = 5 * (opened == 1)
        landmarks.open_wall(opened, [cell - shift for cell in (0, 1, 2)], 4)
        landmarks.merge_walls(0, 1)
        assert not landmarks.covered[0] & {0, 1, 2}
        landmarks.observe_wall(0, np.array([0.15, 0.0, 0.0]), 0.06, 4)  # when all is looked at again
        assert 1 not in landmarks.covered[0]
        landmarks.observe_wall(0, np.array([0.15, 0.0, 0.0]), 0.06, 5)
        assert landmarks.covered[0] & {0, 1, 2} == {1}
