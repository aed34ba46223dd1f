"""Drives through a room that changes: walls that are gone leave the map, others stay, people do not become walls."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Message
from drivers.simulation import LidarModel, Simulation, TemporaryShapes, World
from slam import Slam
from slam.config import Config, config_to_toml
from slam.events import EventRecorder, Finished, WallsRemoved
from slam.io.output_dir import CONFIG
from slam.io.sessions import StoredSession, read_session, write_session
from slam.mapping.map_features import MapWalls
from slam.mapping.wall_cells import WALL_CELL

LIDAR = LidarModel(beams=240, rate=5.0)
NOTHING = np.zeros((0, 4)), np.zeros((0, 3))
PATH = np.array([[1.2, 1.2], [6.8, 1.2], [6.8, 4.8], [1.2, 4.8], [1.2, 1.4], [6.5, 1.4]])
START = np.array([1.2, 1.2, 0.0])  # first pose on this path: the map's frame in the world


def box(x: float, y: float, width: float, depth: float) -> list[list[float]]:
    """Return the four sides of a box with its middle at (x, y)."""
    ends = [(x - width / 2, y - depth / 2), (x + width / 2, y - depth / 2)]
    ends += [(x + width / 2, y + depth / 2), (x - width / 2, y + depth / 2)]
    return [[*a, *b] for a, b in zip(ends, ends[1:] + ends[:1], strict=True)]


CABINET = box(7.0, 5.7, 2.0, 0.6)  # large enough to tell the room from the room turned by 180 degrees
ROOM = np.array([*box(4.0, 3.0, 8.0, 6.0), *CABINET, *box(0.25, 0.2, 0.5, 0.4)])
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
    sinks: Sequence[EventRecorder] = (),
) -> tuple[Slam, Finished]:
    slam = Slam(resumed=resumed, refine=refine, sinks=sinks)
    for message in messages:
        slam.add(message)
    return slam, slam.finish()


def save(session: StoredSession, directory: Path) -> Path:
    directory.mkdir()
    (directory / CONFIG).write_text(config_to_toml(Config()))
    write_session(directory, session)
    return directory


def length_on(walls: MapWalls, segments: np.ndarray, within: float = 0.1) -> float:
    """Return the metres of the map's walls that lie within `within` metres of segments of the world."""
    points, _ = walls.piece_points()
    total = 0.0
    for start, end in points:
        count = max(1, round(float(np.hypot(*(end - start))) / 0.05))
        parts = ((np.arange(count) + 0.5) / count)[:, None]
        for place in se2.transform(START, start + parts * (end - start)).reshape(-1, 2):
            begin, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
            at = np.clip(np.sum((place - begin) * along, axis=1) / np.sum(along**2, axis=1), 0.0, 1.0)
            total += 0.05 * (np.hypot(*(begin + at[:, None] * along - place).T).min() < within)
    return total


@pytest.fixture(scope="module")
def furnished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Save the session of a drive through a room with a partition, and return its directory."""
    slam, finished = run(drive(world(always=np.concatenate([ROOM, PARTITION]))))
    assert length_on(finished.walls, PARTITION) > 5.5
    assert finished.summary["removed_walls"] == 0
    return save(slam.session, tmp_path_factory.mktemp("run") / "out")


@pytest.mark.slow
@pytest.mark.parametrize("refine", [False, True])
def test_a_partition_that_is_gone_leaves_the_map_and_stays_in_the_session(
    furnished: Path, tmp_path: Path, refine: bool
) -> None:
    before = read_session(furnished).slam_state.mapper
    listener = EventRecorder()
    slam, finished = run(drive(world(), seed=2, shift=1000.0), read_session(furnished), refine=refine, sinks=[listener])
    removed = [wall for event in listener.of(WallsRemoved) for wall in event.walls]
    assert sorted(removed) == slam.slam_state.mapper.landmarks.removed_walls().tolist()
    assert length_on(finished.walls, PARTITION) == 0.0
    assert length_on(finished.walls, ROOM) > 28.0
    assert finished.summary["removed_walls"] == 2  # its long sides
    again = read_session(save(slam.session, tmp_path / "out")).slam_state.mapper
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


@pytest.mark.slow
def test_a_partition_that_is_still_there_stays(furnished: Path) -> None:
    same = world(always=np.concatenate([ROOM, PARTITION]))
    _, finished = run(drive(same, seed=2, shift=1000.0), read_session(furnished))
    assert length_on(finished.walls, PARTITION) > 5.5
    assert finished.summary["removed_walls"] == 0


@pytest.mark.slow
def test_a_door_that_is_opened_opens_the_wall(furnished: Path) -> None:
    """A stretch in the middle of the partition is gone, the rest is there, also after refinement."""
    halves = np.array([*box(3.0, 3.0, 1.0, 0.1), *box(5.0, 3.0, 1.0, 0.1)])
    gap = np.array([[3.7, 3.05, 4.3, 3.05], [3.7, 2.95, 4.3, 2.95]])
    place = world(always=np.concatenate([ROOM, halves]))
    slam, finished = run(drive(place, seed=1, shift=1000.0), read_session(furnished), refine=True)
    assert slam.slam_state.mapper.landmarks.opened
    assert length_on(finished.walls, gap, 0.03) < 0.15
    assert length_on(finished.walls, halves) > 3.5
    assert finished.summary["removed_walls"] == 0


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 8))])
def test_a_person_standing_for_some_seconds_is_not_on_the_final_map(seed: int) -> None:
    person = np.array(box(4.0, 3.0, 0.45, 0.3))
    slam, finished = run(drive(world(passing=[TemporaryShapes(0.0, 7.0, person, NOTHING[1])]), seed))
    assert len(slam.slam_state.mapper.landmarks.removed_walls())  # had been mapped
    assert length_on(finished.walls, person) == 0.0
    assert length_on(finished.walls, ROOM) > 28.0


@pytest.mark.slow
def test_a_door_leaf_that_was_open_for_some_seconds_is_not_on_the_final_map() -> None:
    leaf = np.array([[4.0, 3.0, 4.6, 3.6]])
    away = np.array([[4.2, 3.2, 4.6, 3.6]])  # from the hinge
    closed = np.array([[4.0, 3.0, 4.85, 3.0]])
    passing = [TemporaryShapes(0.0, 9.0, leaf, NOTHING[1]), TemporaryShapes(9.0, 99.0, closed, NOTHING[1])]
    slam, finished = run(drive(world(passing=passing)))
    assert len(slam.slam_state.mapper.landmarks.removed_walls())
    assert length_on(finished.walls, away) == 0.0
    assert length_on(finished.walls, closed) > 0.6


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_removed_in_a_building_that_does_not_change(seed: int) -> None:
    """Twice around an office, in which segments sometimes reach across doors."""
    _, finished = run(list(Simulation("office", seed=seed)))
    assert finished.summary["removed_walls"] == 0


@pytest.mark.slow
def test_a_session_restores_the_free_space_evidence(tmp_path: Path) -> None:
    partition = TemporaryShapes(0.0, 16.0, PARTITION, NOTHING[1])
    slam, _ = run(drive(world(passing=[partition]), duration=19.0))
    free_space_evidence = slam.session.slam_state.mapper.free_space_evidence
    assert free_space_evidence.counts
    again = read_session(save(slam.session, tmp_path / "out"), solve=False)
    assert again.slam_state.mapper.free_space_evidence.counts == {
        wall: cells for wall, cells in free_space_evidence.counts.items() if cells
    }
