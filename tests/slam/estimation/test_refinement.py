"""Refinement: it corrects errors of the online estimate, keeps what is correct, and is reproducible."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry
from drivers.simulation import LIDAR_MODELS, WHEEL_MODELS, LidarModel, Simulation
from slam import Config, Finished, Slam
from slam.config import OdometryConfig
from slam.estimation.estimator import Estimator
from slam.estimation.refinement import ScanHistory, build_scan_history, full_map_matcher, refine
from slam.estimation.refinement.even_motions import TRACKED_SIGMAS, even_informations, fractions_of
from slam.estimation.refinement.full_map_matcher import FullMapMatcher
from slam.estimation.refinement.iteration import motion_to_keyframe
from slam.estimation.refinement.landmark_recount import recount_observations
from slam.estimation.slam_state import SlamState
from slam.evaluation.benchmarks.scenarios.buildings import random_building
from slam.evaluation.metrics import score_reference
from slam.events import EventRecorder, GraphInspected, MapUpdated
from slam.geometry.roughness import Roughness
from slam.geometry.segments import CornerPoints, Floats, Segments
from slam.io.tum import Trajectory
from slam.localisation.match_target import MatchTarget, ScanMatch
from slam.localisation.path_distances import MAX_PATH, PathDistances
from slam.localisation.slip_statistics import SlipStatistics
from slam.mapping.convergence import converge
from slam.mapping.keyframes import KeyframeMotion, LandmarkIds
from slam.mapping.mapper import Mapper
from slam.matching.distance_field import DistanceField
from slam.matching.point_matcher import Prediction
from slam.matching.scan_features import ScanFeatures
from slam.matching.scan_points import ScanPoints
from slam.odometry.error_model import OdometryModel
from slam.odometry.history import OdometryHistory
from slam.preprocessing.preprocessor import Preprocessor, ProcessedScan

from ..outlines import visible, with_noise

SMOOTH = Roughness(0.0, 0.0)
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
    """History of a session, its converged map, its odometry model, and the path distances between its keyframes."""

    mapper: Mapper
    history: ScanHistory
    odometry_model: OdometryModel
    messages: list[Message]
    path_distances: PathDistances

    @property
    def poses(self) -> np.ndarray:
        return self.mapper.graph.keyframe_poses(self.mapper.keyframe_count)


@pytest.fixture(scope="module")
def session() -> MappedSession:
    messages = list(Simulation("room", seed=3, duration=16.0, lidar=LidarModel(beams=180, rate=5.0)))
    preprocessor, estimator, scans = Preprocessor(Config()), Estimator(SlamState(Config())), []
    estimator.state.dead_reckoning.history = preprocessor.odometry
    for message in messages:
        if isinstance(message, GroundTruth):
            continue
        preprocessor.add(message)
        while (scan := preprocessor.next_scan()) is not None:
            scans.append(preprocessor.process(scan, estimator.state.odometry_model))
            estimator.process(scans[-1])
    slam_state = estimator.state
    converge(slam_state.mapper)
    history = build_scan_history(
        scans,
        slam_state.trajectory,
        slam_state.keyframe_stamps,
        [preprocessor.odometry],
        slam_state.kidnapped_keyframes,
    )
    path_distances = slam_state.local_field.path_distances(slam_state.mapper.travelled)
    return MappedSession(slam_state.mapper, history, slam_state.odometry_model, messages, path_distances)


def confirmed_walls(mapper: Mapper) -> np.ndarray:
    """Return the ids of the confirmed, unmerged walls."""
    rows = mapper.landmarks.walls.rows
    return np.flatnonzero(rows["in_graph"] & (rows["merged_into"] == np.arange(len(rows))))


def test_history_contains_all_scans_at_their_tracked_poses(session: MappedSession) -> None:
    history, poses = session.history, session.poses
    assert len(history) == len(history.stamps)
    np.testing.assert_allclose(history.relative[history.keyframes], 0.0, atol=1e-12)
    np.testing.assert_array_equal(history.own_keyframes[history.keyframes], np.arange(len(history.keyframes)))
    assert error(history.stamps, history.scan_poses(poses), session.messages) < 0.01


def test_motions_from_scan_to_scan_are_those_between_any_two_scans(session: MappedSession) -> None:
    history, model = replace(session.history, kidnapped=frozenset([0, 7])), session.odometry_model
    wrong = np.arange(len(history)) == 20
    motions, covariances = history.motions(model).known(wrong)
    for row in (0, 6, 7, 19, 20, len(history) - 2):
        motion, covariance = history.motion(row, row + 1, model, wrong)
        np.testing.assert_allclose(motions[row], motion, atol=1e-12)
        np.testing.assert_allclose(covariances[row], covariance, rtol=1e-12)


def test_the_first_scan_is_held_by_odometry_to_the_second(
    session: MappedSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was not matched while driving. Where a few points fit elsewhere too, it must not be searched there."""
    history, nowhere = session.history, np.zeros(len(session.history), dtype=bool)
    matcher = FullMapMatcher(
        history,
        session.mapper.landmarks,
        session.poses,
        session.path_distances,
        SMOOTH,
        0.0,
        session.odometry_model,
        nowhere,
    )
    seen = predictions_of(monkeypatch)
    poses = history.scan_poses(session.poses)
    matcher.match(0, poses, matcher.local_map(0, poses[0]))
    sigmas = np.sqrt(np.diag(np.linalg.inv(seen[0].information)))
    assert np.all(sigmas < [0.05, 0.05, 0.05])


def test_distance_fields_are_kept_for_later_laps(session: MappedSession, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of four places that follow each other again and again, the next one is never among the three used last."""
    monkeypatch.setattr(full_map_matcher, "MAX_FIELDS", 3)
    built, insert = [], DistanceField.insert_scans

    def spy(field: DistanceField, poses: np.ndarray, scans: Sequence[np.ndarray]) -> None:
        built.append(field)
        insert(field, poses, scans)

    monkeypatch.setattr(DistanceField, "insert_scans", spy)
    history, landmarks, poses = session.history, session.mapper.landmarks, np.zeros_like(session.poses)
    keyframes, nowhere = np.arange(len(poses)), np.zeros(len(history), dtype=bool)
    poses[:, 0] = 100.0 * (keyframes // 2 % 2)  # in each of two rooms, one with an even and one with an odd number
    matcher = FullMapMatcher(
        history, landmarks, poses, session.path_distances, SMOOTH, 0.0, session.odometry_model, nowhere
    )
    placed = history.scan_poses(poses)
    for row in range(len(history)):
        matcher.match(row, placed, matcher.local_map(row, placed[row]))
    assert len(poses) > 8
    assert 4 <= len(built) < 0.6 * len(poses)


def predictions_of(monkeypatch: pytest.MonkeyPatch) -> list[Prediction]:
    """Collect the predictions near which scans are matched from now on."""
    seen: list[Prediction] = []
    match = MatchTarget.match

    def spy(
        target: MatchTarget,
        scan: ScanFeatures,
        predictions: Sequence[Prediction],
        points: Floats | None = None,
        **options: bool,
    ) -> ScanMatch:
        seen.extend(predictions)
        return match(target, scan, predictions, points, **options)

    monkeypatch.setattr(MatchTarget, "match", spy)
    return seen


@pytest.mark.parametrize("known_wrong", [False, True])
def test_an_even_motion_costs_as_much_as_a_slip(
    session: MappedSession, monkeypatch: pytest.MonkeyPatch, known_wrong: bool
) -> None:
    history, mapper, row = session.history, session.mapper, 60
    wrong, poses = np.zeros(len(history), dtype=bool), history.scan_poses(session.poses)
    wrong[row], middle = known_wrong, poses[row].copy()
    poses[row] = se2.compose(middle, np.array([0.5, 0.0, 0.0]))  # away from the motion between its neighbours
    matcher = FullMapMatcher(
        history, mapper.landmarks, session.poses, session.path_distances, SMOOTH, 0.0, session.odometry_model, wrong
    )
    seen = predictions_of(monkeypatch)
    matcher.match(row, poses, matcher.local_map(row, poses[row]))
    present, even = seen
    of_slip = SlipStatistics(scans=len(history), slips=0).cost
    assert (present.cost, even.cost) == (0.0, 0.0 if known_wrong else of_slip)
    np.testing.assert_allclose(even.pose, middle, atol=0.05)


@pytest.mark.parametrize(("tracked", "least", "most"), [(True, 0.01, 0.1), (False, 0.2, 0.4)])
def test_a_scan_between_tracked_neighbours_is_searched_near_the_even_motion(
    session: MappedSession, monkeypatch: pytest.MonkeyPatch, tracked: bool, least: float, most: float
) -> None:
    """A robot cannot jump by decimetres and back within two tenths of a second, wherever a single scan fits."""
    history, row = session.history, 60
    informations = history.informations.copy()
    informations[row - 1 : row + 2] *= tracked
    history = replace(history, informations=informations)
    wrong, poses = np.zeros(len(history), dtype=bool), history.scan_poses(session.poses)
    poses[row] = se2.compose(poses[row], np.array([0.0, 0.0, 2.0]))
    landmarks = session.mapper.landmarks
    matcher = FullMapMatcher(
        history, landmarks, session.poses, session.path_distances, SMOOTH, 0.0, session.odometry_model, wrong
    )
    seen = predictions_of(monkeypatch)
    matcher.match(row, poses, matcher.local_map(row, poses[row]))
    sigmas = np.sqrt(np.diag(np.linalg.inv(seen[1].information)))
    assert np.all(sigmas[:2] > least)
    assert np.all(sigmas < most)


def test_correct_map_stays_correct(session: MappedSession) -> None:
    refined = refine(session.mapper, session.history, session.odometry_model, session.path_distances)
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
    refined = refine(corrupted, session.history, session.odometry_model, session.path_distances)
    assert len(confirmed_walls(refined.mapper)) < len(confirmed_walls(corrupted))
    assert refined.summary["walls_merged"] >= 1
    before = error(session.history.stamps, session.history.scan_poses(session.poses), session.messages)
    assert error(session.history.stamps, refined.poses, session.messages) < before + 2e-4


def test_converged_map_has_no_duplicate_walls(session: MappedSession) -> None:
    corrupted = duplicate_wall(session)
    corrupted.recompute_pose_covariances()
    before = confirmed_walls(corrupted)
    assert converge(corrupted) >= 1
    assert len(confirmed_walls(corrupted)) < len(before)
    assert converge(corrupted) == 0


def test_wrong_initial_pose_of_a_scan_is_corrected(session: MappedSession) -> None:
    history = session.history
    row = int(history.keyframes[len(history.keyframes) // 2]) + 1
    relative = history.relative.copy()
    relative[row] = se2.compose(relative[row], [0.08, -0.05, 0.03])
    refined = refine(
        session.mapper, replace(history, relative=relative), session.odometry_model, session.path_distances
    )
    expected = refine(session.mapper, history, session.odometry_model, session.path_distances)
    assert np.abs(refined.poses[row] - expected.poses[row]).max() < 0.003


# Arrays of no segments.
NOTHING = np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2))
NO_CORNERS = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)))
# Metres.
STEP = 0.4


def drive_through_clutter() -> tuple[Mapper, ScanHistory, np.ndarray]:
    """Drive twice through posts without any wall, with an odometry that drifts by half a metre in between.

    Returns the map of the online estimate, which scan matches and a loop closed by agreement put right, the history,
    and the true poses (n, 3).
    """
    random = np.random.default_rng(0)
    posts = random.uniform([-1.0, -5.0], [9.0, 5.0], (60, 2))
    along = np.arange(0.0, 8.0, STEP)
    through, count = np.column_stack([along, np.zeros((len(along), 2))]), len(along)
    true = np.concatenate([through, through + np.array([0.1, 0.0, 0.0])])
    odometry = np.concatenate([true[:count], se2.compose(np.array([0.3, 0.4, 0.03]), true[count:])])
    scans = []
    for k, (pose, odometry_pose) in enumerate(zip(true, odometry, strict=True)):
        points = with_noise(visible(posts, pose), random)
        features = ScanFeatures(Segments(*NOTHING), NO_CORNERS, ScanPoints(points))
        scans.append(ProcessedScan(0.5 * k, odometry_pose, features))
    every, zeros = np.arange(2 * count), np.zeros((2 * count, 3))
    history = ScanHistory(scans, every, every, zeros, np.zeros((2 * count, 3, 3)), OdometryHistory(), frozenset())
    model, mapper, covariance = OdometryModel(OdometryConfig()), Mapper(), np.diag([0.01, 0.01, 0.003]) ** 2
    none = LandmarkIds(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))
    for k, scan in enumerate(scans):
        motion = None if k == 0 else motion_to_keyframe(k, history, model, np.zeros(2 * count, dtype=bool))
        mapper.add_keyframe_with_ids(odometry[k], motion, scan.features.segments, NO_CORNERS, none)
        if k not in (0, count):
            mapper.graph.add_point_map(k - 1, covariance)
            mapper.graph.add_scan_match(k - 1, k, se2.between(true[k - 1], true[k]), covariance)
    for k in (0, 5, 10, 15):
        mapper.graph.add_loop(k, count + k, se2.between(true[k], true[count + k]), covariance)
    mapper.graph.add_submap_match(2, count + 2, se2.between(true[2], true[count + 2]), covariance)
    mapper.solve()
    return mapper, history, true


def passes_of(count: int, links: Sequence[tuple[int, int]] = ()) -> PathDistances:
    """Return the path distances of two passes of half of the keyframes each, far apart along the drive."""
    return PathDistances.along([STEP * k for k in range(count)], {count // 2: MAX_PATH}, links)


@pytest.mark.parametrize("linked", [False, True])
def test_only_linked_passes_count_as_one_map(linked: bool) -> None:
    """No loop was closed, so that the earlier pass is 0.25 m aside of the later one, which has few keyframes."""
    mapper, history, true = drive_through_clutter()
    count, drift = len(true) // 2, np.array([0.0, 0.25, 0.0])
    keyframes = np.array([*range(count), count, count + 7, count + 14])
    poses = true[keyframes] + np.where(keyframes < count, 0.0, 1.0)[:, None] * drift
    own = np.maximum(np.searchsorted(keyframes, np.arange(2 * count), side="right") - 1, 0)
    relative = se2.between(true[keyframes[own]], true)
    history = replace(history, keyframes=keyframes, own_keyframes=own, relative=relative)
    path_distances = passes_of(len(keyframes), [(1, count)] if linked else [])
    path_distances = replace(path_distances, driven=STEP * keyframes + MAX_PATH * (keyframes >= count))
    nowhere, model = np.zeros(2 * count, dtype=bool), OdometryModel(OdometryConfig())
    matcher = FullMapMatcher(history, mapper.landmarks, poses, path_distances, SMOOTH, 0.0, model, nowhere)
    placed = history.scan_poses(poses)
    moved = np.zeros(2 * count)
    for row in range(count, 2 * count):
        match = matcher.match(row, placed, matcher.local_map(row, placed[row]))
        moved[row] = np.hypot(*(match.points.pose - placed[row])[:2])
    assert (moved.max() > 0.1) == linked


def test_matches_and_loops_by_agreement_are_kept() -> None:
    mapper, history, true = drive_through_clutter()
    assert np.hypot(*(mapper.keyframe_poses - true)[:, :2].T).max() < 0.02
    refined = refine(mapper, history, OdometryModel(OdometryConfig()), passes_of(mapper.keyframe_count))
    kept, expected = refined.mapper.graph.matches(), mapper.graph.matches()
    assert [(f.kind, f.first, f.second) for f in kept] == [(f.kind, f.first, f.second) for f in expected]
    for factor, before in zip(kept, expected, strict=True):
        np.testing.assert_array_equal(factor.measured, before.measured)
        np.testing.assert_array_equal(factor.covariance, before.covariance)
    assert np.hypot(*(refined.mapper.keyframe_poses - true)[:, :2].T).max() < 0.02
    assert np.hypot(*(refined.poses - true)[:, :2].T).max() < 0.05


def test_refinement_is_reproducible_and_publishes_the_map() -> None:
    messages = list(Simulation("room", seed=5, duration=8.0))
    listener = EventRecorder()
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
    assert np.isin([m.stamp for m in messages if isinstance(m, Odometry)], first.stamps).all()
    assert np.linalg.eigvalsh(first.walls.covariance).min() > 0
    last, inspected, finished = listener.events[-3:]
    assert isinstance(inspected, GraphInspected)
    assert isinstance(last, MapUpdated)
    assert isinstance(finished, Finished)
    np.testing.assert_array_equal(last.walls.frame, finished.walls.frame)
    np.testing.assert_array_equal(last.keyframe_poses, finished.keyframes.poses)


def test_session_without_a_map_is_not_refined() -> None:
    messages = list(Simulation("room", seed=5, duration=0.3))
    finished = run(messages, refine=True)
    assert "refinement" not in finished.summary
    assert len(finished.poses)


def test_an_even_motion_is_as_certain_as_the_poses_around_it_and_the_acceleration_leave_it() -> None:
    informations = np.array([np.diag([4e4, 1e4, 1e6]) * (k + 1) for k in range(4)])
    intervals = [0.0, 0.1, 0.3, 30.0]  # a robot may have any velocity after the last one
    fractions = fractions_of(intervals)
    assert fractions[1] == pytest.approx(0.25)
    covariances = np.linalg.inv(even_informations(intervals, fractions, informations))
    changes = np.array([0.2, 0.2, 0.6]), np.array([1.0, 1.0, 2.0])  # metres and radians per second
    for row, change in zip((1, 2), changes, strict=True):
        share = fractions[row]
        of_poses = np.linalg.inv(informations)
        expected = (1.0 - share) ** 2 * of_poses[row - 1] + share**2 * of_poses[row + 1]
        expected += np.diag(TRACKED_SIGMAS**2 + (share * intervals[row + 1] * change) ** 2)
        np.testing.assert_allclose(covariances[row], expected, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(covariances[[0, -1]], [np.diag(TRACKED_SIGMAS**2)] * 2, atol=1e-15)


@pytest.mark.slow
def test_stopped_odometry_is_detected() -> None:
    """Scans during the stop are placed by their neighbours, also if the online estimate followed odometry."""
    messages = list(Simulation("office", seed=1, duration=14.0, lidar=LidarModel(beams=180, rate=5.0)))
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


@pytest.mark.slow
def test_scans_in_corridors_stay_where_odometry_has_them() -> None:
    """Along a bare corridor every pose fits as well: matching to the finished map must not move a scan there."""
    drive = list(Simulation(random_building(9128), 9128, 50.0, LIDAR_MODELS["short"], WHEEL_MODELS["bad"]))
    finished, truth = run(drive, refine=False), ground_truth(drive)
    true = truth.at(finished.stamps).poses
    at_keyframe = truth.at(finished.keyframes.stamps[:1]).poses[0]
    errors = se2.between(finished.poses, se2.between(at_keyframe, true))
    assert np.hypot(errors[:, 0], errors[:, 1]).max() < 0.2  # metres; 0.6 if one was moved
