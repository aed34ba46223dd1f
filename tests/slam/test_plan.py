"""Plans of a building: a robot localises in them, and mapping uses what agrees with them and reports what does not."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth, Message
from drivers.simulation import LIDAR_MODELS, WHEEL_MODELS, LidarModel, Simulation
from drivers.simulation.world import load_world
from slam import Slam
from slam.config import Config, LoopClosureConfig, config_to_toml
from slam.errors import MapError
from slam.evaluation.metrics import align
from slam.events import EventRecorder, Finished, Notice
from slam.geometry.segments import Floats
from slam.io.exports import OccupancyGrid, Thresholds, place_scans, write_pgm, write_pgm_yaml
from slam.io.output_dir import CONFIG
from slam.io.plans.reader import read_plan
from slam.io.sessions import read_session, write_session
from slam.io.sessions.plan_session import plan_session
from slam.io.tum import Trajectory
from slam.mapping.plan import Plan
from slam.mapping.plan_map import PlanMap, build_plan_map
from slam.offline.map_diff import ChangeKind
from slam.offline.map_diff.plan import compare_with_plan, survey_plan
from slam.offline.optimisation import optimise

from .simulated_worlds import furnished_room

FEW_BEAMS = LidarModel(beams=360, rate=5.0)
SIGMAS = (0.03, np.radians(0.3))
SHIFT, WING = 0.45, 11.0
"""Metres by which the wing east of some x is elsewhere in the wrong plan, to the north and to the east: walls are
paired up to half a metre, and those at the limit by chance."""
WRONG = 0.3
"""Metres by which a wall of the southern corridor is too far north in the wrong plan."""
START = np.array([5.2, 5.0, 0.0])
"""Pose at the beginning of the drive through the office, nearly."""


def office(*, wrong: bool = False) -> PlanMap:
    """Return the plan of the office."""
    segments = load_world("office").segments.reshape(-1, 2, 2).copy()
    if wrong:
        x, y = segments[..., 0], segments[..., 1]
        in_wing, in_wall = x.min(axis=1) > WING, (np.abs(y - 5.9).max(axis=1) < 0.15) & (x.max(axis=1) < WING + 0.5)
        segments[in_wing] += SHIFT
        segments[in_wall & ~in_wing, :, 1] += WRONG
    return build_plan_map(Plan("office", segments, np.zeros(len(segments), dtype=bool), 1e-3), SIGMAS)


@pytest.fixture(scope="module")
def drive() -> list[Message]:
    return list(Simulation("office", seed=2, duration=30.0))


@pytest.fixture(scope="module")
def sparse_drive() -> list[Message]:
    """Return the same drive with half as many scans, and fewer beams."""
    return list(Simulation("office", seed=2, duration=30.0, lidar=FEW_BEAMS))


def run(messages: Sequence[Message], slam: Slam) -> Finished:
    for message in messages:
        slam.add(message)
    return slam.finish()


def errors(finished: Finished, messages: Sequence[Message], *, aligned: bool = False) -> Floats:
    """Return the distances (metres) of the path from the true one, if `aligned` after a rigid motion."""
    true = [message for message in messages if isinstance(message, GroundTruth)]
    truth = Trajectory(np.array([m.stamp for m in true]), np.array([m.pose for m in true]))
    known = (finished.stamps >= truth.stamps[0]) & (finished.stamps <= truth.stamps[-1])
    poses, reference = finished.poses[known], truth.at(finished.stamps[known]).poses
    if aligned:
        poses = se2.compose(align(poses[:, :2], reference[:, :2]), poses)
    return np.hypot(*(poses - reference)[:, :2].T)


@pytest.fixture(scope="module")
def without_plan(drive: list[Message]) -> Finished:
    return run(drive, Slam())


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("precision", [1e-3, 0.05 / 12**0.5], ids=["drawing", "grid"])
@pytest.mark.parametrize("length", [0.6, 4.0])
def test_short_walls_of_a_coarse_plan_have_an_uncertain_heading(precision: float, length: float) -> None:
    """As uncertain as lines through two points with such errors, and what is stated for every wall."""
    outline = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 6.0], [0.0, 6.0]])
    wall = np.array([[2.0, 1.0], [2.0, 1.0 + length]])
    lines = np.concatenate([wall[None], np.stack([outline, np.roll(outline, -1, axis=0)], axis=1)])
    walls = build_plan_map(Plan("walls", lines, np.zeros(5, dtype=bool), precision), SIGMAS).walls
    (row,) = np.flatnonzero((np.abs(walls.frame[:, 0] - 2.0) < 1e-9) & (walls.frame[:, 2] > 0.0))
    drawn = wall + np.random.default_rng(0).normal(0.0, precision, (20_000, 2, 2))
    along = drawn[:, 1] - drawn[:, 0]
    sigma = np.hypot(np.std(np.arctan2(along[:, 0], along[:, 1])), SIGMAS[1])
    assert np.sqrt(walls.covariance[row, 1, 1]) == pytest.approx(sigma, rel=0.02)


def test_a_map_is_recognised_in_a_plan_and_is_in_its_frame(
    drive: list[Message], without_plan: Finished, tmp_path: Path
) -> None:
    listener = EventRecorder()
    slam = Slam(sinks=[listener], plan=office())
    finished = run(drive, slam)
    assert [notice.text for notice in listener.of(Notice)] == ["recognised in the plan"]
    assert errors(finished, drive).max() < 0.02
    assert rms(errors(finished, drive, aligned=True)) < 1.2 * rms(errors(without_plan, drive, aligned=True)) + 5e-4
    write_session(tmp_path, slam.session)
    (tmp_path / CONFIG).write_text(config_to_toml(Config()))
    stored = slam.session.slam_state.mapper.graph
    restored = read_session(tmp_path, solve=False).slam_state.mapper.graph
    assert len(stored.plan_walls()) > 20
    assert stored.plan_walls().keys() == restored.plan_walls().keys()
    np.testing.assert_allclose(restored.keyframe_pose(5), stored.keyframe_pose(5), atol=1e-6)


@pytest.fixture(scope="module")
def short_drive() -> list[Message]:
    """Return a drive through a room whose walls are on borders of the cells of distance fields, two of them at 0."""
    return list(Simulation(furnished_room(), seed=0, duration=15.0, lidar=FEW_BEAMS))


def moved_room(motion: se2.Pose) -> PlanMap:
    """Return the plan of the room in another frame."""
    segments = se2.transform(motion, furnished_room().segments.reshape(-1, 2, 2))
    return build_plan_map(Plan("room", segments, np.zeros(len(segments), dtype=bool), 1e-3), SIGMAS)


MOTIONS = {
    "as built": np.zeros(3),
    "between cells": np.array([0.11, 0.17, 0.0]),
    "national grid": np.array([5.0e5, 5.5e6, 2.0]),
}
"""Poses of the frame of the building in that of its plan."""
EACH_MOTION = [
    pytest.param(motion, id=name, marks=[] if name == "national grid" else pytest.mark.slow)
    for name, motion in MOTIONS.items()
]


@pytest.mark.parametrize("motion", EACH_MOTION)
def test_a_plan_may_have_any_frame_to_map_in_it(motion: se2.Pose, short_drive: list[Message]) -> None:
    slam = Slam(plan=moved_room(motion))
    finished = run(short_drive, slam)
    assert slam.slam_state.plan is not None
    assert slam.slam_state.plan.recognised
    in_building = replace(finished, poses=se2.compose(se2.inverse(motion), finished.poses))
    assert errors(in_building, short_drive).max() < 0.01


@pytest.mark.parametrize("motion", EACH_MOTION)
def test_a_plan_may_have_any_frame_to_localise_in_it(motion: se2.Pose, short_drive: list[Message]) -> None:
    finished = run(short_drive, Slam(resumed=plan_session(moved_room(motion), Config()), frozen=True))
    in_building = replace(finished, poses=se2.compose(se2.inverse(motion), finished.poses))
    assert finished.stamps[0] < 1.0
    assert errors(in_building, short_drive).max() < 0.02


@pytest.mark.slow
def test_a_wrong_plan_does_not_bend_the_map_and_is_reported(drive: list[Message], without_plan: Finished) -> None:
    plan = office(wrong=True)
    slam = Slam(plan=plan, start=START + np.array([0.2, -0.2, 0.1]))
    finished = run(drive, slam)
    assert errors(finished, drive).max() < 0.03
    assert rms(errors(finished, drive, aligned=True)) < 1.2 * rms(errors(without_plan, drive, aligned=True)) + 5e-4
    found, _ = compare_with_plan(survey_plan(plan), slam.slam_state, slam.session)
    moved = [change for change in found.changes if change.kind is ChangeKind.MOVED]
    at_wall = [one for one in moved if np.allclose(one.stretches[..., 1], 5.8 + WRONG, atol=0.01)]
    assert [round(one.shift, 2) for one in at_wall] == [WRONG]  # it is seen from the south: left is south
    in_wing = [one for one in moved if one.stretches[..., 0].min() > WING]
    assert len(in_wing) > 5
    assert np.mean([abs(abs(one.shift) - SHIFT) < 0.02 for one in in_wing]) > 0.8
    assert not [one for one in moved if one.stretches[..., 0].max() < WING and one not in at_wall]


def grid_map(messages: Sequence[Message], path: Path) -> Path:
    """Write a grid map of the scans of a drive, at their true poses."""
    true = [message for message in messages if isinstance(message, GroundTruth)]
    trajectory = Trajectory(np.array([m.stamp for m in true]), np.array([m.pose for m in true]))
    grid = OccupancyGrid(0.05)
    grid.add_all(place_scans(messages, trajectory, Config()))
    occupancy = grid.occupancy(Thresholds())
    write_pgm(path.with_suffix(".pgm"), occupancy)
    write_pgm_yaml(path.with_suffix(".yaml"), occupancy, path.with_suffix(".pgm").name)
    return path.with_suffix(".yaml")


@pytest.mark.parametrize("kind", ["drawing", pytest.param("grid map", marks=pytest.mark.slow)])
def test_a_robot_localises_in_a_plan_from_anywhere(sparse_drive: list[Message], kind: str, tmp_path: Path) -> None:
    plan, begin, end = office(), 5.0, 12.0
    if kind == "grid map":
        another_drive = list(Simulation("office", seed=3, duration=30.0, lidar=FEW_BEAMS))
        plan, end = build_plan_map(read_plan(grid_map(another_drive, tmp_path / "map")), SIGMAS), 25.0
    messages = [message for message in sparse_drive if begin < message.stamp < end]
    finished = run(messages, Slam(resumed=plan_session(plan, Config()), frozen=True))
    assert finished.stamps[0] < begin + 1.0
    assert errors(finished, messages).max() < (0.02 if kind == "drawing" else 0.05)


def drive_round_the_square(seed: int, rate: float, reach: float) -> tuple[list[Message], Slam]:
    """Return a drive with bad wheels round a building, whose plan shows the southern part, and the pipeline for it.

    The robot is back in the southern part after 110 s.
    """
    segments = load_world("square").segments.reshape(-1, 2, 2)
    shown = segments[segments[..., 1].max(axis=1) < 5.0]
    plan = build_plan_map(Plan("square", shown, np.zeros(len(shown), dtype=bool), 1e-3), SIGMAS)
    lidar, wheels = replace(LIDAR_MODELS["short"], rate=rate, range_max=reach), WHEEL_MODELS["bad"]
    messages = list(Simulation("square", seed=seed, duration=135.0, lidar=lidar, wheels=wheels))
    start = next(message.pose for message in messages if isinstance(message, GroundTruth))
    return messages, Slam(Config(loop_closure=LoopClosureConfig(enabled=False)), plan=plan, start=start)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_drift_where_the_plan_shows_nothing_is_corrected_when_the_robot_returns(seed: int) -> None:
    """Along the corridor on which it returns, the drift is half a metre, while both sides agree with the plan."""
    messages, slam = drive_round_the_square(seed, rate=3.0, reach=8.0)
    drift = 0.0
    for message in messages:
        slam.add(message)
        if isinstance(message, GroundTruth) and 10.0 < message.stamp < 110.0:  # the place is recognised after some 5 s
            drift = max(drift, float(np.hypot(*(slam.pose - message.pose)[:2])))
    assert drift > 0.5
    final = errors(slam.finish(), messages)
    assert final.max() < 0.2
    assert final[-1] < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "rate"), [(2, 5.5), (3, 2.5), (3, 4.5)])
def test_a_robot_that_turned_blindly_is_recognised_when_it_returns(seed: int, rate: float) -> None:
    """In halls wider than the range it turns by odometry alone: behind them the map is off by more than 5 m."""
    messages, slam = drive_round_the_square(seed, rate, reach=6.0)
    assert errors(run(messages, slam), messages).max() < 0.5


@pytest.mark.slow
def test_a_plan_that_is_localised_in_can_be_extended(sparse_drive: list[Message], tmp_path: Path) -> None:
    """The eastern part of the office is not in the plan. The path has nothing but the drive, also when refined."""
    segments = load_world("office").segments.reshape(-1, 2, 2)
    known = segments[segments[..., 0].max(axis=1) < WING + 0.5]
    plan = build_plan_map(Plan("west", known, np.zeros(len(known), dtype=bool), 1e-3), SIGMAS)
    slam = Slam(resumed=plan_session(plan, Config()), frozen=True, start=START)
    for message in sparse_drive:
        if slam.frozen and message.stamp > sparse_drive[0].stamp + 5.0:
            slam.unfreeze()
        slam.add(message)
    walls = len(plan.walls)
    finished = slam.finish()
    assert finished.stamps[0] >= sparse_drive[0].stamp
    assert len(finished.walls) > walls
    assert errors(finished, sparse_drive).max() < 0.08
    (tmp_path / CONFIG).write_text(config_to_toml(Config()))
    write_session(tmp_path, slam.session)
    continued = Slam(resumed=read_session(tmp_path))
    for message in sparse_drive[-400:]:
        continued.add(replace(message, stamp=message.stamp + 100.0))
    assert continued.finish().stamps[0] >= sparse_drive[0].stamp
    assert optimise(read_session(tmp_path)).finished.stamps[0] >= sparse_drive[0].stamp


@pytest.mark.slow
def test_a_refined_map_is_supported_by_the_plan(sparse_drive: list[Message]) -> None:
    messages = [message for message in sparse_drive if message.stamp < 10.0]
    slam = Slam(refine=True, plan=office(), start=START)
    finished = run(messages, slam)
    assert "refinement" in finished.summary
    assert len(slam.slam_state.mapper.graph.plan_walls()) > 10
    assert errors(finished, messages).max() < 0.02


@pytest.mark.slow
def test_a_plan_of_another_building_is_left_out(sparse_drive: list[Message]) -> None:
    segments = load_world("museum").segments.reshape(-1, 2, 2)
    museum = build_plan_map(Plan("museum", segments, np.zeros(len(segments), dtype=bool), 1e-3), SIGMAS)
    listener = EventRecorder()
    slam = Slam(sinks=[listener], plan=museum)
    run([message for message in sparse_drive if message.stamp < 10.0], slam)
    assert any("never recognised in the plan" in notice.text for notice in listener.of(Notice))
    assert not slam.slam_state.mapper.graph.plan_walls()


def test_a_plan_without_a_room_is_refused() -> None:
    lines = np.array([[[0.0, 0.0], [5.0, 0.0]]])
    with pytest.raises(MapError, match="two lines: has no room"):
        Slam(plan=build_plan_map(Plan("two lines", lines, np.zeros(1, dtype=bool), 1e-3), SIGMAS))
