"""The second look: it repairs what the first got wrong, leaves alone what was right, and is the same each time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry
from drivers.simulation import Simulation
from slam import Config, Finished, Slam
from slam.config import OdometryConfig
from slam.estimation.estimator import Estimator
from slam.estimation.refinement import ScanHistory, build_scan_history, refine
from slam.estimation.refinement.landmark_recount import recount
from slam.estimation.slam_state import SlamState
from slam.evaluation.metrics import score_reference
from slam.events import GraphInspected, MapUpdated
from slam.geometry.segments import CornerPoints, Segments
from slam.io.tum import Trajectory
from slam.mapping.keyframes import KeyframeMotion, LandmarkIds
from slam.mapping.mapper import Mapper
from slam.matching.likelihood_field import ScanPoints
from slam.matching.line_matcher import ScanFeatures
from slam.odometry.error_model import OdometryModel
from slam.preprocessing.preprocessor import Preprocessor, ProcessedScan
from slam.run_statistics import StageTimer

from ..listeners import EventCollector

DOUBLED = 0.03  # metres between a wall and its false twin


def run(messages: Iterable[Message], *, refine: bool) -> Finished:
    slam = Slam(refine=refine)
    for message in messages:
        slam.add(message)
    return slam.finish()


def truth_of(messages: Iterable[Message]) -> Trajectory:
    truth = [message for message in messages if isinstance(message, GroundTruth)]
    return Trajectory(np.array([t.stamp for t in truth]), np.array([t.pose for t in truth]))


def error(stamps: np.ndarray, poses: np.ndarray, messages: Iterable[Message]) -> float:
    """Root mean square distance from the true path, metres."""
    return score_reference(Trajectory(stamps, poses), truth_of(messages)).figures()["ate_rmse"]


@dataclass
class Driven:
    """A drive, the map that was made of it, settled, and how far odometry is trusted."""

    mapper: Mapper
    drive: ScanHistory
    noise: OdometryModel
    messages: list[Message]

    @property
    def poses(self) -> np.ndarray:
        return self.mapper.graph.keyframe_poses(self.mapper.keyframe_count)


@pytest.fixture(scope="module")
def driven() -> Driven:
    messages = list(Simulation("room", seed=3, duration=16.0))
    front_end, estimator, scans = Preprocessor(Config()), Estimator(SlamState(Config().odometry)), []
    for message in messages:
        if isinstance(message, GroundTruth):
            continue
        front_end.add(message)
        while (scan := front_end.next_scan()) is not None:
            scans.append(front_end.sight(scan, estimator.slam_state.odometry_model))
            estimator.take(scans[-1], StageTimer())
    slam_state = estimator.slam_state
    slam_state.mapper.converge()
    drive = build_scan_history(scans, slam_state.trajectory, slam_state.keyframe_stamps, slam_state.kidnapped_keyframes)
    return Driven(slam_state.mapper, drive, slam_state.odometry_model, messages)


def walls_of(mapper: Mapper) -> np.ndarray:
    """Identities of the confirmed walls."""
    rows = mapper.landmarks.walls.rows
    return np.flatnonzero(rows["in_graph"] & (rows["merged_into"] == np.arange(len(rows))))


def test_a_drive_is_all_sightings_where_the_path_has_them(driven: Driven) -> None:
    drive, poses = driven.drive, driven.poses
    assert len(drive) == len(drive.stamps)
    np.testing.assert_allclose(drive.relative[drive.keyframes], 0.0, atol=1e-12)
    np.testing.assert_array_equal(drive.anchors[drive.keyframes], np.arange(len(drive.keyframes)))
    assert error(drive.stamps, drive.poses(poses), driven.messages) < 0.01


def test_a_good_map_is_not_made_worse(driven: Driven) -> None:
    refined = refine(driven.mapper, driven.drive, driven.noise)
    before = error(driven.drive.stamps, driven.drive.poses(driven.poses), driven.messages)
    assert error(driven.drive.stamps, refined.poses, driven.messages) < before + 2e-4
    assert abs(len(walls_of(refined.mapper)) - len(walls_of(driven.mapper))) <= 2
    np.testing.assert_allclose(refined.mapper.graph.keyframe_pose(0), driven.poses[0], atol=1e-9)
    assert refined.summary["largest_shift"] < 0.02


def doubled(driven: Driven) -> Mapper:
    """The map with its most seen wall mapped twice: what the second half of the drive saw of it is of a twin."""
    old, drive, poses = driven.mapper, driven.drive, driven.poses
    mapper, half = Mapper.with_landmarks_of(old), len(poses) // 2
    rows = old.landmarks.walls.rows
    kept = rows["merged_into"]
    names = [LandmarkIds(np.where(n.walls >= 0, kept[n.walls], -1), n.corners) for n in old.landmark_ids]
    late = np.concatenate([n.walls for n in names[half:]])
    wall = int(np.bincount(late[late >= 0]).argmax())
    beside = se2.compose(rows["frame"][wall], [0.0, DOUBLED, 0.0])
    twin = mapper.landmarks.add_wall(beside, 0.5, half)
    names[half:] = [replace(n, walls=np.where(n.walls == wall, twin, n.walls)) for n in names[half:]]
    recount(mapper.landmarks, drive, names, poses)
    certain = np.zeros(len(drive), dtype=bool)
    for k, row in enumerate(drive.keyframes):
        seen = drive.scans[row].features
        motion = None
        if k:
            motion = KeyframeMotion(k - 1, *drive.motion(int(drive.keyframes[k - 1]), int(row), driven.noise, certain))
        mapper.add_keyframe_with_ids(poses[k], motion, seen.segments, seen.corners, names[k])
    mapper.solve()
    assert {wall, twin} <= set(walls_of(mapper))
    return mapper


def test_a_wall_that_was_mapped_twice_becomes_one(driven: Driven) -> None:
    spoilt = doubled(driven)
    refined = refine(spoilt, driven.drive, driven.noise)
    assert len(walls_of(refined.mapper)) < len(walls_of(spoilt))
    assert refined.summary["walls_merged"] >= 1
    before = error(driven.drive.stamps, driven.drive.poses(driven.poses), driven.messages)
    assert error(driven.drive.stamps, refined.poses, driven.messages) < before + 2e-4


def test_a_map_that_comes_to_rest_has_no_wall_twice(driven: Driven) -> None:
    spoilt = doubled(driven)
    spoilt.recompute_pose_covariances()
    before = walls_of(spoilt)
    assert spoilt.converge() >= 1
    assert len(walls_of(spoilt)) < len(before)
    assert spoilt.converge() == 0


def test_what_was_believed_of_a_sighting_gives_way_to_what_it_shows(driven: Driven) -> None:
    """Keyframes that are given to the wrong walls, and a pose that is off, find back."""
    drive = driven.drive
    row = int(drive.keyframes[len(drive.keyframes) // 2]) + 1
    relative = drive.relative.copy()
    relative[row] = se2.compose(relative[row], [0.08, -0.05, 0.03])
    refined = refine(driven.mapper, replace(drive, relative=relative), driven.noise)
    expected = refine(driven.mapper, drive, driven.noise)
    assert np.abs(refined.poses[row] - expected.poses[row]).max() < 0.003


# A room with unequal sides, a niche and a bay: walls as frames with x along them, seen from the room, and half their
# lengths.
ROOM = np.array(
    [
        [3.0, 0.0, 0.0, 3.0],
        [6.0, 3.25, np.pi / 2, 0.75],
        [4.5, 4.0, np.pi, 1.5],
        [3.0, 4.75, np.pi / 2, 0.75],
        [1.5, 5.5, np.pi, 1.5],
        [0.0, 2.75, -np.pi / 2, 2.75],
        [7.5, -0.8, 0.0, 1.5],
        [9.0, 0.85, np.pi / 2, 1.65],
        [7.5, 2.5, np.pi, 1.5],
    ]
)
WITHOUT_BAY, AT_BAY = 6, 5  # walls that are seen from the door on; steps through the room from which on all are
STEP = 0.4  # metres
LAP = 60  # steps of a turn through nowhere, back to the room


def visited_twice() -> tuple[ScanHistory, np.ndarray, np.ndarray]:
    """A drive through the room, around in a circle where nothing is to be seen, and through the room again; its true
    poses, and those that odometry has, which is off by most of a metre at the end."""
    through = [np.array([STEP, 0.0, 0.0])] * 10
    turn = np.array([STEP, 0.0, 2 * np.pi / LAP])
    back = [*([np.array([-STEP, 0.0, 0.0])] * 10), *([turn] * LAP)]
    motions = [*through, *back, *through]
    true, claimed = [np.array([1.0, 1.0, 0.3])], [np.zeros(3)]
    for k, motion in enumerate(motions):
        true.append(se2.compose(true[-1], motion))
        slip = [0.04, 0.0, 0.002] if len(through) + 10 <= k < len(through) + 10 + LAP // 2 else np.zeros(3)
        claimed.append(se2.compose(claimed[-1], motion + slip))
    nothing = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)))
    scans = []
    for k, (pose, odometry) in enumerate(zip(true, claimed, strict=True)):
        steps_in = min(k, 20 - k) if k <= 20 else k - (len(motions) - 10)
        walls = ROOM[: 0 if steps_in < 0 else WITHOUT_BAY if steps_in < AT_BAY else len(ROOM)]
        uncertain = np.tile(np.diag([0.005, 0.004]) ** 2, (len(walls), 1, 1))
        segments = Segments(se2.between(pose, walls[:, :3]).reshape(-1, 3), walls[:, 3], uncertain)
        seen = ScanFeatures(segments, nothing, ScanPoints(np.zeros((0, 2)), np.zeros((0, 2))))
        scans.append(ProcessedScan(0.5 * k, odometry, seen))
    every = np.arange(len(scans))
    count = len(scans)
    drive = ScanHistory(scans, every, every, np.zeros((count, 3)), np.zeros((count, 3, 3)), frozenset())
    return drive, np.array(true), np.array(claimed)


def test_a_loop_that_was_never_closed_is_closed() -> None:
    drive, true, claimed = visited_twice()
    noise, mapper = OdometryModel(OdometryConfig()), Mapper()
    certain = np.zeros(len(drive), dtype=bool)
    for end in (0, -1):  # the room as the first and the last sighting have it
        for wall in ROOM:
            frame = se2.compose(claimed[end], se2.between(true[end], wall[:3]))
            mapper.landmarks.add_wall(frame, wall[3], 0)
    for k, scan in enumerate(drive.scans):
        seen, visit = scan.features, int(k > 40)
        names = LandmarkIds(np.arange(len(seen.segments)) + visit * len(ROOM), np.zeros(0, dtype=np.int64))
        motion = KeyframeMotion(k - 1, *drive.motion(k - 1, k, noise, certain)) if k else None
        mapper.landmarks.walls.rows["observations"][names.walls] = 10
        mapper.add_keyframe_with_ids(claimed[k], motion, seen.segments, seen.corners, names)
    recount(mapper.landmarks, drive, mapper.landmark_ids, claimed)
    mapper.landmarks.walls.rows["in_graph"] = True
    mapper.solve()
    apart = se2.between(true[0], true)
    before = np.hypot(*(mapper.keyframe_poses - apart)[-1, :2])
    assert before > 0.6
    refined = refine(mapper, drive, noise)
    assert refined.summary["closures_added"] == 1
    assert len(walls_of(refined.mapper)) == len(ROOM)
    assert np.hypot(*(refined.poses - apart)[-10:, :2].T).max() < 0.02


def test_refining_twice_gives_the_same_and_tells_of_the_map() -> None:
    messages = list(Simulation("room", seed=5, duration=8.0))
    listener = EventCollector()
    results = []
    for _ in range(2):
        slam = Slam(sinks=[listener], refine=True)
        for message in messages:
            slam.add(message)
        results.append(slam.finish())
    first, second = results
    np.testing.assert_array_equal(first.poses, second.poses)
    np.testing.assert_array_equal(first.lines.covariance, second.lines.covariance)
    assert first.summary["refinement"] == second.summary["refinement"]
    np.testing.assert_array_equal(first.stamps, [m.stamp for m in messages if isinstance(m, Odometry)])
    assert np.linalg.eigvalsh(first.lines.covariance).min() > 0
    last, inspected, finished = listener.events[-3:]
    assert isinstance(inspected, GraphInspected)
    assert isinstance(last, MapUpdated)
    assert isinstance(finished, Finished)
    np.testing.assert_array_equal(last.lines.frame, finished.lines.frame)
    np.testing.assert_array_equal(last.keyframes, finished.keyframes)


def test_where_nothing_was_mapped_nothing_is_refined() -> None:
    messages = list(Simulation("room", seed=5, duration=0.3))
    finished = run(messages, refine=True)
    assert "refinement" not in finished.summary
    assert len(finished.poses)


def test_odometry_that_stands_still_and_catches_up_is_seen_through() -> None:
    """The scans in between belong where the others say, also where the first look believed odometry."""
    messages = list(Simulation("office", seed=1, duration=14.0))
    halted = [m for m in messages if isinstance(m, Odometry) and 8.0 < m.stamp - messages[0].stamp < 8.7]
    stands = [replace(m, pose=halted[0].pose) if m in halted else m for m in messages]
    finished = run(stands, refine=True)
    truth = truth_of(messages)
    score = score_reference(Trajectory(finished.stamps, finished.poses), truth)
    assert score.figures()["ate_max"] < 0.30  # between two scans there is nothing but odometry
    assert score.figures()["ate_rmse"] < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_refined_paths_are_as_good_or_better(seed: int) -> None:
    messages = list(Simulation("office", seed=seed))
    online, refined = (run(messages, refine=refine) for refine in (False, True))
    assert error(refined.stamps, refined.poses, messages) <= error(online.stamps, online.poses, messages)
