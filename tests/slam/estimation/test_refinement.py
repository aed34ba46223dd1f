"""Refinement: it corrects errors of the online estimate, keeps what is correct, and is reproducible."""

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
from slam.estimation.refinement.landmark_recount import recount_observations
from slam.estimation.slam_state import SlamState
from slam.evaluation.metrics import score_reference
from slam.events import GraphInspected, MapUpdated
from slam.geometry.segments import CornerPoints, Segments
from slam.io.tum import Trajectory
from slam.mapping.keyframes import KeyframeMotion, LandmarkIds
from slam.mapping.mapper import Mapper
from slam.matching.line_matcher import ScanFeatures
from slam.matching.scan_points import ScanPoints
from slam.odometry.error_model import OdometryModel
from slam.preprocessing.preprocessor import Preprocessor, ProcessedScan

from ..listeners import EventCollector

TWIN_DISTANCE = 0.03  # metres between a wall and its false twin


def run(messages: Iterable[Message], *, refine: bool) -> Finished:
    slam = Slam(refine=refine)
    for message in messages:
        slam.add(message)
    return slam.finish()


def ground_truth(messages: Iterable[Message]) -> Trajectory:
    truth = [message for message in messages if isinstance(message, GroundTruth)]
    return Trajectory(np.array([t.stamp for t in truth]), np.array([t.pose for t in truth]))


def error(stamps: np.ndarray, poses: np.ndarray, messages: Iterable[Message]) -> float:
    """Return the RMS position error of a trajectory, metres."""
    return score_reference(Trajectory(stamps, poses), ground_truth(messages)).figures()["ate_rmse"]


@dataclass
class MappedSession:
    """History of a session, its converged map, and its odometry model."""

    mapper: Mapper
    history: ScanHistory
    odometry_model: OdometryModel
    messages: list[Message]

    @property
    def poses(self) -> np.ndarray:
        return self.mapper.graph.keyframe_poses(self.mapper.keyframe_count)


@pytest.fixture(scope="module")
def session() -> MappedSession:
    messages = list(Simulation("room", seed=3, duration=16.0))
    preprocessor, estimator, scans = Preprocessor(Config()), Estimator(SlamState(Config())), []
    for message in messages:
        if isinstance(message, GroundTruth):
            continue
        preprocessor.add(message)
        while (scan := preprocessor.next_scan()) is not None:
            scans.append(preprocessor.process(scan, estimator.state.odometry_model))
            estimator.process(scans[-1])
    slam_state = estimator.state
    slam_state.mapper.converge()
    history = build_scan_history(
        scans, slam_state.trajectory, slam_state.keyframe_stamps, slam_state.kidnapped_keyframes
    )
    return MappedSession(slam_state.mapper, history, slam_state.odometry_model, messages)


def confirmed_walls(mapper: Mapper) -> np.ndarray:
    """Return the ids of the confirmed, unmerged walls."""
    rows = mapper.landmarks.walls.rows
    return np.flatnonzero(rows["in_graph"] & (rows["merged_into"] == np.arange(len(rows))))


def test_history_contains_all_scans_at_their_tracked_poses(session: MappedSession) -> None:
    history, poses = session.history, session.poses
    assert len(history) == len(history.stamps)
    np.testing.assert_allclose(history.relative[history.keyframes], 0.0, atol=1e-12)
    np.testing.assert_array_equal(history.anchors[history.keyframes], np.arange(len(history.keyframes)))
    assert error(history.stamps, history.scan_poses(poses), session.messages) < 0.01


def test_correct_map_stays_correct(session: MappedSession) -> None:
    refined = refine(session.mapper, session.history, session.odometry_model)
    before = error(session.history.stamps, session.history.scan_poses(session.poses), session.messages)
    assert error(session.history.stamps, refined.poses, session.messages) < before + 2e-4
    assert abs(len(confirmed_walls(refined.mapper)) - len(confirmed_walls(session.mapper))) <= 2
    np.testing.assert_allclose(refined.mapper.graph.keyframe_pose(0), session.poses[0], atol=1e-9)
    assert refined.summary["largest_shift"] < 0.02


def duplicate_wall(session: MappedSession) -> Mapper:
    """Return the map with its most observed wall duplicated: observations of the second half are of a twin."""
    old, history, poses = session.mapper, session.history, session.poses
    mapper, half = Mapper.with_landmarks_of(old), len(poses) // 2
    rows = old.landmarks.walls.rows
    merged_into = rows["merged_into"]
    landmark_ids = [
        LandmarkIds(np.where(ids.walls >= 0, merged_into[ids.walls], -1), ids.corners) for ids in old.landmark_ids
    ]
    late = np.concatenate([ids.walls for ids in landmark_ids[half:]])
    wall = int(np.bincount(late[late >= 0]).argmax())
    beside = se2.compose(rows["frame"][wall], [0.0, TWIN_DISTANCE, 0.0])
    twin = mapper.landmarks.add_wall(beside, 0.5, half)
    landmark_ids[half:] = [
        replace(ids, walls=np.where(ids.walls == wall, twin, ids.walls)) for ids in landmark_ids[half:]
    ]
    recount_observations(mapper.landmarks, history, landmark_ids, poses)
    odometry_wrong = np.zeros(len(history), dtype=bool)
    for k, row in enumerate(history.keyframes):
        features = history.scans[row].features
        motion = None
        if k:
            motion = KeyframeMotion(
                k - 1, *history.motion(int(history.keyframes[k - 1]), int(row), session.odometry_model, odometry_wrong)
            )
        mapper.add_keyframe_with_ids(poses[k], motion, features.segments, features.corners, landmark_ids[k])
    mapper.solve()
    assert {wall, twin} <= set(confirmed_walls(mapper))
    return mapper


def test_duplicate_walls_are_merged(session: MappedSession) -> None:
    corrupted = duplicate_wall(session)
    refined = refine(corrupted, session.history, session.odometry_model)
    assert len(confirmed_walls(refined.mapper)) < len(confirmed_walls(corrupted))
    assert refined.summary["walls_merged"] >= 1
    before = error(session.history.stamps, session.history.scan_poses(session.poses), session.messages)
    assert error(session.history.stamps, refined.poses, session.messages) < before + 2e-4


def test_converged_map_has_no_duplicate_walls(session: MappedSession) -> None:
    corrupted = duplicate_wall(session)
    corrupted.recompute_pose_covariances()
    before = confirmed_walls(corrupted)
    assert corrupted.converge() >= 1
    assert len(confirmed_walls(corrupted)) < len(before)
    assert corrupted.converge() == 0


def test_wrong_initial_pose_of_a_scan_is_corrected(session: MappedSession) -> None:
    history = session.history
    row = int(history.keyframes[len(history.keyframes) // 2]) + 1
    relative = history.relative.copy()
    relative[row] = se2.compose(relative[row], [0.08, -0.05, 0.03])
    refined = refine(session.mapper, replace(history, relative=relative), session.odometry_model)
    expected = refine(session.mapper, history, session.odometry_model)
    assert np.abs(refined.poses[row] - expected.poses[row]).max() < 0.003


# Walls of a room with unequal sides, a niche and a bay: frame [x, y, heading] and half length.
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
# Number of walls visible from the door on, and the step in the room from which all are visible.
WITHOUT_BAY, AT_BAY = 6, 5
# Metres.
STEP = 0.4
# Metres between the points of a wall.
POINT_SPACING = 0.06
# Number of steps on the circle outside, where no wall is visible.
LAP = 60


def points_on(segments: Segments) -> np.ndarray:
    """Return points (n, 2) about every POINT_SPACING along the segments."""
    points = [np.zeros((0, 2))]
    for frame, half in zip(segments.frame, segments.half_length, strict=True):
        along = np.linspace(-half, half, int(2 * half / POINT_SPACING))
        points.append(se2.transform(frame, np.column_stack([along, np.zeros(len(along))])))
    return np.concatenate(points)


def visited_twice() -> tuple[ScanHistory, np.ndarray, np.ndarray]:
    """Simulate a drive through the room, a circle without any features, and the room again.

    Returns the history, the true poses (n, 3) and the odometry (n, 3), which is wrong by most of a metre at the end.
    """
    through = [np.array([STEP, 0.0, 0.0])] * 10
    turn = np.array([STEP, 0.0, 2 * np.pi / LAP])
    back = [*([np.array([-STEP, 0.0, 0.0])] * 10), *([turn] * LAP)]
    motions = [*through, *back, *through]
    true, odometry = [np.array([1.0, 1.0, 0.3])], [np.zeros(3)]
    for k, motion in enumerate(motions):
        true.append(se2.compose(true[-1], motion))
        slip = [0.04, 0.0, 0.002] if len(through) + 10 <= k < len(through) + 10 + LAP // 2 else np.zeros(3)
        odometry.append(se2.compose(odometry[-1], motion + slip))
    nothing = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)))
    scans = []
    for k, (pose, odometry_pose) in enumerate(zip(true, odometry, strict=True)):
        steps_in = min(k, 20 - k) if k <= 20 else k - (len(motions) - 10)
        walls = ROOM[: 0 if steps_in < 0 else WITHOUT_BAY if steps_in < AT_BAY else len(ROOM)]
        covariance = np.tile(np.diag([0.005, 0.004]) ** 2, (len(walls), 1, 1))
        segments = Segments(se2.between(pose, walls[:, :3]).reshape(-1, 3), walls[:, 3], covariance)
        features = ScanFeatures(segments, nothing, ScanPoints(points_on(segments), np.zeros((0, 2))))
        scans.append(ProcessedScan(0.5 * k, odometry_pose, features))
    every = np.arange(len(scans))
    count = len(scans)
    history = ScanHistory(scans, every, every, np.zeros((count, 3)), np.zeros((count, 3, 3)), frozenset())
    return history, np.array(true), np.array(odometry)


def test_missed_loop_is_closed() -> None:
    history, true, odometry = visited_twice()
    model, mapper = OdometryModel(OdometryConfig()), Mapper()
    odometry_wrong = np.zeros(len(history), dtype=bool)
    for end in (0, -1):  # the room at the first and at the last scan, by odometry
        for wall in ROOM:
            frame = se2.compose(odometry[end], se2.between(true[end], wall[:3]))
            mapper.landmarks.add_wall(frame, wall[3], 0)
    for k, scan in enumerate(history.scans):
        features, visit = scan.features, int(k > 40)
        landmark_ids = LandmarkIds(np.arange(len(features.segments)) + visit * len(ROOM), np.zeros(0, dtype=np.int64))
        motion = KeyframeMotion(k - 1, *history.motion(k - 1, k, model, odometry_wrong)) if k else None
        mapper.landmarks.walls.rows["observations"][landmark_ids.walls] = 10
        mapper.add_keyframe_with_ids(odometry[k], motion, features.segments, features.corners, landmark_ids)
    recount_observations(mapper.landmarks, history, mapper.landmark_ids, odometry)
    mapper.landmarks.walls.rows["in_graph"] = True
    mapper.solve()
    relative_truth = se2.between(true[0], true)
    before = np.hypot(*(mapper.keyframe_poses - relative_truth)[-1, :2])
    assert before > 0.6
    refined = refine(mapper, history, model)
    assert refined.summary["closures_added"] == 1
    assert len(confirmed_walls(refined.mapper)) == len(ROOM)
    assert np.hypot(*(refined.poses - relative_truth)[-10:, :2].T).max() < 0.02


def test_refinement_is_reproducible_and_publishes_the_map() -> None:
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
    np.testing.assert_array_equal(first.walls.covariance, second.walls.covariance)
    assert first.summary["refinement"] == second.summary["refinement"]
    np.testing.assert_array_equal(first.stamps, [m.stamp for m in messages if isinstance(m, Odometry)])
    assert np.linalg.eigvalsh(first.walls.covariance).min() > 0
    last, inspected, finished = listener.events[-3:]
    assert isinstance(inspected, GraphInspected)
    assert isinstance(last, MapUpdated)
    assert isinstance(finished, Finished)
    np.testing.assert_array_equal(last.walls.frame, finished.walls.frame)
    np.testing.assert_array_equal(last.keyframes, finished.keyframes)


def test_session_without_a_map_is_not_refined() -> None:
    messages = list(Simulation("room", seed=5, duration=0.3))
    finished = run(messages, refine=True)
    assert "refinement" not in finished.summary
    assert len(finished.poses)


def test_stopped_odometry_is_detected() -> None:
    """Scans during the stop are placed by their neighbours, also if the online estimate followed odometry."""
    messages = list(Simulation("office", seed=1, duration=14.0))
    halted = [m for m in messages if isinstance(m, Odometry) and 8.0 < m.stamp - messages[0].stamp < 8.7]
    stands = [replace(m, pose=halted[0].pose) if m in halted else m for m in messages]
    finished = run(stands, refine=True)
    truth = ground_truth(messages)
    score = score_reference(Trajectory(finished.stamps, finished.poses), truth)
    assert score.figures()["ate_max"] < 0.30  # between two scans only odometry is available
    assert score.figures()["ate_rmse"] < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_refined_trajectories_are_as_good_or_better(seed: int) -> None:
    messages = list(Simulation("office", seed=seed))
    online, refined = (run(messages, refine=refine) for refine in (False, True))
    assert error(refined.stamps, refined.poses, messages) <= error(online.stamps, online.poses, messages)
