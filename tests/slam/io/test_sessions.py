"""A session is read back as it was written."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from drivers import Odometry, Scan, se2
from drivers.simulation import LIDAR_MODELS, LidarModel, Simulation
from features import LearnedNoise
from slam import Slam
from slam.config import LidarConfig, load_config
from slam.errors import MapError
from slam.estimation.slam_state import SlamState
from slam.geometry.roughness import Roughness
from slam.graph.graph_storage import graph_state
from slam.io.exports import place_stored_scans
from slam.io.output_dir import SESSION
from slam.io.sessions import Recording, StoredSession, is_session, read_session
from slam.io.sessions.session import HEADER, RECENT_KEYFRAMES, SCANS
from slam.io.tum import Trajectory
from slam.loop_closure.decision import LoopMatch
from slam.loop_closure.loop_hypothesis import LoopAgreementState, LoopHypothesis, OldPlace
from slam.mapping.convergence import converge
from slam.mapping.mapper import Mapper
from slam.odometry.systematic_errors import PERFECT
from slam.preprocessing.message_check import MessageCheck
from slam.preprocessing.preprocessor import NO_FEATURES
from slam.preprocessing.scan_sequence import ScanSequence

from ..earlier_sessions import remove_odometry_stamps
from .conftest import ROOM, write_directory


def estimate(mapper: Mapper) -> tuple[np.ndarray, np.ndarray, float]:
    walls = graph_state(mapper.graph).walls
    poses = mapper.graph.keyframe_poses(mapper.keyframe_count)
    return poses, mapper.graph.wall_frames(walls), mapper.graph.chi2()


def test_estimate_is_read_back(written: tuple[StoredSession, Path]) -> None:
    session, path = written
    assert is_session(path)
    restored = read_session(path)
    assert restored.recordings == [ROOM]
    assert restored.config == session.config
    expected, mapper = (some.slam_state.copy().mapper for some in (session, restored))
    expected.solve_waiting()
    for before, after in zip(estimate(expected), estimate(mapper), strict=True):
        np.testing.assert_allclose(after, before, rtol=1e-3, atol=1e-4)  # iSAM2 substitutes back to a threshold
    converge(expected)
    converge(mapper)
    for before, after in zip(estimate(expected), estimate(mapper), strict=True):
        np.testing.assert_allclose(after, before, rtol=1e-6, atol=1e-6)  # both are a micrometre from the optimum


def test_beams_begin_at_the_lidars_of_their_recording(intact: Path, tmp_path: Path) -> None:
    session = read_session(intact)
    middle = session.scans[len(session.scans) // 2].stamp
    parts = {0.0: [(0.1, 0.0, 0.0)], middle: [(-0.2, 0.0, 3.0)]}
    session.recordings[:] = [ROOM.model_copy(update={"first": first, "lidars": at}) for first, at in parts.items()]
    write_directory(tmp_path / "parts", session)
    restored = read_session(tmp_path / "parts")
    stamps, unknown = np.array([scan.stamp for scan in restored.scans]), np.ones((1, 2))
    standing = Trajectory(stamps, np.zeros((len(stamps), 3)))
    for scan in place_stored_scans(restored, standing, unknown):
        assert scan.origin.tolist() == [-0.2 if scan.stamp >= middle else 0.1, 0.0]
    restored.recordings[:] = [ROOM]  # as in sessions of older versions
    assert next(place_stored_scans(restored, standing, unknown)).origin.tolist() == [1.0, 1.0]


def test_slam_state_is_read_back(written: tuple[StoredSession, Path]) -> None:
    session, path = written
    restored = read_session(path, solve=False)
    expected, state = session.slam_state, restored.slam_state
    for name in ("walls", "corners"):
        before, after = (getattr(some.mapper.landmarks, name).rows for some in (expected, state))
        for column in before.dtype.names:
            # only the upper triangle of a covariance is stored, and the two agree except for rounding
            np.testing.assert_allclose(after[column], before[column], rtol=1e-9, atol=1e-15, err_msg=column)
    assert state.mapper.landmarks.covered == expected.mapper.landmarks.covered
    assert state.mapper.landmarks.opened == expected.mapper.landmarks.opened
    assert state.mapper.free_space_evidence.counts == expected.mapper.free_space_evidence.counts
    assert state.mapper.roughness.variances == expected.mapper.roughness.variances
    np.testing.assert_array_equal(state.odometry_model.deviations, expected.odometry_model.deviations)
    for before, after in zip(expected.mapper.landmark_ids, state.mapper.landmark_ids, strict=True):
        np.testing.assert_array_equal(after.walls, before.walls)
        np.testing.assert_array_equal(after.corners, before.corners)
    covariances = expected.mapper.pose_covariances
    np.testing.assert_allclose(state.mapper.pose_covariances, covariances, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(state.mapper.correlated_drift, expected.mapper.correlated_drift, rtol=1e-9, atol=1e-15)
    assert len(state.mapper.unconfirmed_observations) == len(expected.mapper.unconfirmed_observations)
    np.testing.assert_array_equal(state.mapper.travelled, expected.mapper.travelled)
    np.testing.assert_allclose(state.pose, expected.pose, atol=1e-12)
    np.testing.assert_array_equal(restored.odometry[0].stamps, session.odometry[0].stamps)
    np.testing.assert_array_equal(restored.odometry[0].poses, session.odometry[0].poses)


def test_agreement_on_a_loop_is_read_back(written: tuple[StoredSession, Path], tmp_path: Path) -> None:
    """What was looked at and found so far is kept, so that a continued run closes the same loops."""
    session = read_session(written[1])
    random, state = np.random.default_rng(0), session.slam_state
    match = LoopMatch(3, 1, random.normal(size=3), np.diag([0.01, 0.02, 0.003]), 1.25, 0.9, 0.7)
    place = OldPlace(np.array([0, 1, 2]), random.normal(size=(3, 3)))
    hypothesis = LoopHypothesis(random.normal(size=3), [match], [0.25], admitted=False)
    expected = LoopAgreementState(1.75, [(1, place)], [(1, 1.5)], [0.25, 0.75], [0.5], [hypothesis], 3, [np.ones(3)])
    state.loops.restore(expected, state.local_field)
    write_directory(tmp_path / "out", session)
    restored = read_session(tmp_path / "out").slam_state.loops.state
    assert (restored.last_search, list(restored.returned_at)) == (1.75, [0.25, 0.75])
    assert (list(restored.searched), restored.candidates) == ([(1, 1.5)], 3)
    np.testing.assert_array_equal(restored.retracted, [np.ones(3)])
    ((centre, same),) = restored.places
    assert centre == 1
    np.testing.assert_array_equal(same.keyframes, place.keyframes)
    np.testing.assert_array_equal(same.poses, place.poses)
    assert restored.contradictions == (0.5,)
    (same_hypothesis,) = restored.hypotheses
    np.testing.assert_array_equal(same_hypothesis.motion, hypothesis.motion)
    assert (same_hypothesis.contradictions, same_hypothesis.admitted) == ([0.25], False)
    (saved,) = same_hypothesis.support
    for name in LoopMatch.__slots__:
        np.testing.assert_array_equal(getattr(saved, name), getattr(match, name), err_msg=name)


def test_contradictions_are_read_from_earlier_versions(written: tuple[StoredSession, Path], tmp_path: Path) -> None:
    """The estimate was a hypothesis in them."""
    header = shutil.copytree(written[1], tmp_path / "out") / SESSION / HEADER
    data = json.loads(header.read_text())
    del data["agreement"]["contradictions"]
    data["agreement"]["estimate"] = {"motion": [0.0] * 3, "support": [], "contradictions": [0.5]}
    header.write_text(json.dumps(data))
    assert read_session(tmp_path / "out").slam_state.loops.state.contradictions == (0.5,)


def test_scans_are_read_back(written: tuple[StoredSession, Path]) -> None:
    session, path = written
    expected, history = session.scan_history(), read_session(path).scan_history()
    np.testing.assert_array_equal(history.stamps, expected.stamps)
    np.testing.assert_array_equal(history.odometry, expected.odometry)
    np.testing.assert_array_equal(history.keyframes, expected.keyframes)
    np.testing.assert_array_equal(history.own_keyframes, expected.own_keyframes)
    np.testing.assert_array_equal(history.relative, expected.relative)
    np.testing.assert_array_equal(history.has_features, expected.has_features)
    for before, after in ((b.features, a.features) for b, a in zip(expected.scans, history.scans, strict=True)):
        np.testing.assert_allclose(after.segments.frame, before.segments.frame, atol=1e-6)
        np.testing.assert_allclose(after.segments.covariance, before.segments.covariance, rtol=1e-6)
        np.testing.assert_allclose(after.corners.position, before.corners.position, atol=1e-6)
        np.testing.assert_array_equal(after.corners.segments, before.corners.segments)
        np.testing.assert_allclose(se2.wrap(after.corners.headings - before.corners.headings), 0, atol=1e-6)
        np.testing.assert_allclose(after.points.xy, before.points.xy, atol=6e-4)
        assert after.points.sigma == before.points.sigma
        np.testing.assert_allclose(after.sweep_covariance, before.sweep_covariance, rtol=1e-6)
    assert history.sweep_covariances.any()
    for row in expected.keyframes[-5:]:  # the next scans will be matched to these
        before, after = expected.scans[row].features, history.scans[row].features
        np.testing.assert_array_equal(after.segments.frame, before.segments.frame)
        np.testing.assert_array_equal(after.points.xy, before.points.xy)
        np.testing.assert_array_equal(after.sweep_covariance, before.sweep_covariance)


def test_scans_of_earlier_versions_have_no_sweep_covariance_and_no_noise_of_points(
    written: tuple[StoredSession, Path], tmp_path: Path
) -> None:
    """The errors of the sweep were part of the covariances of their segments and corners."""
    path = shutil.copytree(written[1], tmp_path / "out")
    for file in (path / SESSION / SCANS, path / SESSION / RECENT_KEYFRAMES):
        pq.write_table(pq.read_table(file).drop_columns(["sweep_covariance", "point_sigma"]), file)
    history = read_session(path).scan_history()
    assert not history.sweep_covariances.any()
    assert not any(scan.features.points.sigma for scan in history.scans)


def test_scans_are_the_same_in_any_number_of_groups(
    written: tuple[StoredSession, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Scans of long drives are written in groups of rows, to bound the memory for it."""
    session, path = written
    monkeypatch.setattr("slam.io.sessions.scans.GROUP_ROWS", 7)
    write_directory(tmp_path / "groups", session)
    file = Path(SESSION) / SCANS
    parts, whole = pq.ParquetFile(tmp_path / "groups" / file), pq.ParquetFile(path / file)
    assert parts.num_row_groups == -(-len(session.scans) // 7)
    assert whole.num_row_groups == 1
    assert parts.read().equals(whole.read())
    assert len(read_session(tmp_path / "groups").scans) == len(session.scans)


def test_arrays_of_features_are_contiguous_as_in_a_run(written: tuple[StoredSession, Path]) -> None:
    """With another memory layout, compiled functions would be compiled a second time."""
    session, path = written
    for history in (session.scan_history(), read_session(path).scan_history()):
        for scan in history.scans:
            segments, corners = scan.features.segments, scan.features.corners
            arrays = segments.frame, segments.half_length, segments.covariance, corners.covariance
            assert all(array.flags.c_contiguous for array in (*arrays, corners.position, corners.headings))


@pytest.mark.parametrize(
    ("first", "message"),
    [
        ([1e11, 0.0, 0.0], r"session\.json: checkpoint\.tracker\.fix\.odometry\.0: input should be less than"),
        ([0.0, 0.0, 1e12], r"odometry\.parquet: the column heading has values beyond"),
    ],
)
def test_a_session_is_written_whatever_its_values_are_and_the_reader_names_the_invalid_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, first: list[float], message: str
) -> None:
    """No message may have such values, so an error of the program has led to them."""
    monkeypatch.setattr(MessageCheck, "checked", lambda _self, message: message)
    slam = Slam()
    for reading in Simulation("room", seed=3, duration=2.0, lidar=LIDAR_MODELS["short"]):
        slam.add(replace(reading, pose=reading.pose + first) if isinstance(reading, Odometry) else reading)
    slam.finish()
    write_directory(tmp_path, slam.session)
    with pytest.raises(MapError, match=message):
        read_session(tmp_path)


@pytest.mark.parametrize(
    "settings",
    [
        ["odometry.translation_error=1000"],
        pytest.param(["odometry.rotation_walk=1000"], marks=pytest.mark.slow),
        pytest.param(["odometry.translation_floor=1000", "odometry.rotation_floor=1000"], marks=pytest.mark.slow),
        ["lidar.mount=[100,-100,6.28]", "lidar.range_max=inf"],
    ],
)
def test_a_session_of_settings_at_their_limits_is_read_back(tmp_path: Path, settings: list[str]) -> None:
    slam = Slam(load_config(overrides=settings))
    for message in Simulation("office", seed=3, duration=4.0, lidar=LidarModel(beams=360, rate=5.0)):
        slam.add(replace(message, ranges=message.ranges * 10.0) if isinstance(message, Scan) else message)
    slam.finish()
    write_directory(tmp_path, slam.session)
    restored = read_session(tmp_path)
    assert len(restored.scans) == len(slam.session.scans)
    assert restored.config == slam.session.config


def test_numbers_that_are_not_finite_are_null_in_the_header(tmp_path: Path) -> None:
    slam = Slam()
    for message in Simulation("room", seed=3, duration=2.0, lidar=LIDAR_MODELS["short"]):
        slam.add(message)
    slam.finish()
    slam.session.recordings.append(Recording.model_construct(name="a", path=None, first=np.nan, last=1.0))
    write_directory(tmp_path, slam.session)
    with pytest.raises(MapError, match=r"session\.json: recordings\.0\.first: input should be a valid number"):
        read_session(tmp_path)


def test_session_is_small(written: tuple[StoredSession, Path]) -> None:
    session, path = written
    size = (path / SESSION / SCANS).stat().st_size
    assert size < 2500 * len(session.scans)  # 360 points and some twelve features per scan


def test_scan_without_features_is_read_back_without_features(tmp_path: Path) -> None:
    slam = Slam()
    for message in Simulation("room", seed=3, duration=2.0, lidar=LIDAR_MODELS["short"]):
        slam.add(message)
    slam.finish()
    session = slam.session
    last = len(session.scans) - 1
    scans = ScanSequence(session.scans)
    scans.drop_features([last])
    session.scans = scans
    write_directory(tmp_path, session)
    restored = read_session(tmp_path)
    assert restored.scans[last].features is NO_FEATURES
    assert restored.scan_history().has_features.sum() == last


def test_what_a_drive_through_a_known_map_goes_on_from_is_kept(
    written: tuple[StoredSession, Path], tmp_path: Path
) -> None:
    """How uncertain the pose is from which odometry predicts, and the errors of odometry that are expected."""
    session = read_session(written[1])
    state, covariance = session.slam_state, np.diag([0.04, 0.01, 0.0004])
    state.tracker.correct(state.pose, covariance)
    state.odometry_model.begin_drive()
    write_directory(tmp_path / "out", session)
    restored = read_session(tmp_path / "out").slam_state
    for before, after in zip(
        *(some.odometry_model.systematic_errors.values for some in (state, restored)), strict=True
    ):
        assert after == before
    tracker = restored.tracker.state
    assert tracker is not None
    np.testing.assert_array_equal(tracker.reference.covariance, covariance)
    header = tmp_path / "out" / SESSION / HEADER
    data = json.loads(header.read_text())
    del data["sensor_models"]["odometry_expected"]  # as earlier versions have written it
    del data["checkpoint"]["tracker"]["reference"]["covariance"]
    header.write_text(json.dumps(data))
    earlier = read_session(tmp_path / "out").slam_state
    np.testing.assert_array_equal(earlier.odometry_model.systematic_errors.values, PERFECT)


def test_the_readings_of_odometry_at_fixes_are_kept(written: tuple[StoredSession, Path], tmp_path: Path) -> None:
    """Earlier versions have kept only their poses: their stamps are taken to be that of the last scan."""
    session, path = written[0], shutil.copytree(written[1], tmp_path / "out")
    expected, restored = (readings_at_fixes(some.slam_state) for some in (session, read_session(path)))
    last = session.scans[-1].stamp
    assert min(reading.stamp for reading in expected) < last
    header = path / SESSION / HEADER
    data = json.loads(header.read_text())
    remove_odometry_stamps(data["checkpoint"])
    header.write_text(json.dumps(data))
    earlier = readings_at_fixes(read_session(path).slam_state)
    for before, after, of_earlier in zip(expected, restored, earlier, strict=True):
        assert after.stamp == before.stamp
        assert of_earlier.stamp == last
        np.testing.assert_array_equal(after.pose, before.pose)
        np.testing.assert_array_equal(of_earlier.pose, before.pose)


def test_the_roughness_is_kept(written: tuple[StoredSession, Path], tmp_path: Path) -> None:
    """Its variances depend on those before, so that the samples alone may give others."""
    saved, path = written[0].slam_state.mapper.roughness, shutil.copytree(written[1], tmp_path / "out")
    header = path / SESSION / HEADER
    data = json.loads(header.read_text())
    assert data["sensor_models"]["roughness_variances"] == list(saved.variances)
    data["sensor_models"]["roughness_variances"] = [4e-6, 9e-6]
    header.write_text(json.dumps(data))
    restored = read_session(path).slam_state.mapper.roughness
    assert restored.variances == Roughness(4e-6, 9e-6)
    np.testing.assert_array_equal(restored.samples, saved.samples)


def test_the_roughness_of_earlier_sessions_is_that_of_offsets_and_ends(
    written: tuple[StoredSession, Path], tmp_path: Path
) -> None:
    """Earlier versions have estimated one variance for both, from samples without what was expected."""
    path = shutil.copytree(written[1], tmp_path / "out")
    header = path / SESSION / HEADER
    data = json.loads(header.read_text())
    data["sensor_models"]["roughness_samples"] = [1e-5, 2e-5, 4e-5] * 100
    del data["sensor_models"]["roughness_variances"]
    header.write_text(json.dumps(data))
    assert read_session(path).slam_state.mapper.roughness.variances == pytest.approx((2e-5, 2e-5))


def readings_at_fixes(state: SlamState) -> list[Odometry]:
    tracker, anchor = state.checkpoint.tracker, state.checkpoint.anchor
    assert tracker is not None
    assert anchor is not None
    return [tracker.fix.odometry, tracker.reference.odometry, anchor.odometry]


def test_the_noise_of_rays_is_kept(written: tuple[StoredSession, Path], tmp_path: Path) -> None:
    session, path = written[0], shutil.copytree(written[1], tmp_path / "out")
    assert read_session(path).noise == session.noise
    assert session.noise.lines < np.inf
    header = path / SESSION / HEADER
    data = json.loads(header.read_text())
    for name in ("sigma_bearing", "segmentation_range", "noise_scans", "noise_lines"):
        del data["sensor_models"][name]
    header.write_text(json.dumps(data))
    sigma_range = session.noise.sigma_range
    assert read_session(path).noise == LearnedNoise(sigma_range, LidarConfig().sigma_bearing, sigma_range)
