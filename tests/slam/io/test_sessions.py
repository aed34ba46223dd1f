"""What a run leaves behind can be gone on from: it is read back as it was, or refused with a reason."""

import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers import se2
from drivers.simulation import Simulation
from slam import Slam
from slam.config import Config, config_to_toml
from slam.errors import MapError, SlamError
from slam.io.output_dir import CONFIG, SESSION
from slam.io.sessions import Recording, StoredSession, is_session, read_session, write_session
from slam.io.sessions.session import ADRIFT, FACTORS, HEAD, KEYFRAMES, SIGHTINGS, WALLS
from slam.mapping.landmark_table import NEVER_REMOVED
from slam.mapping.mapper import Mapper
from slam.preprocessing.preprocessor import NO_FEATURES

ROOM = Recording(name="room", path="sim:room", first=0.0, last=8.0)


def leave(directory: Path, session: StoredSession) -> None:
    directory.mkdir(exist_ok=True)
    (directory / CONFIG).write_text(config_to_toml(session.config))
    write_session(directory, session)


@pytest.fixture(scope="module", params=[False, True], ids=["online", "refined"])
def left(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[StoredSession, Path]:
    slam = Slam(Config(), refine=request.param)
    for message in Simulation("room", seed=3, duration=8.0):
        slam.add(message)
    slam.finish()
    session = slam.session
    session.recordings.append(ROOM)
    path = tmp_path_factory.mktemp("run") / "out"
    leave(path, session)
    return session, path


def estimate(mapper: Mapper) -> tuple[np.ndarray, np.ndarray, float]:
    walls = mapper.graph.state().walls
    poses = mapper.graph.keyframe_poses(mapper.keyframe_count)
    return poses, mapper.graph.wall_frames(walls), mapper.graph.chi2()


def test_the_estimate_is_read_back(left: tuple[StoredSession, Path]) -> None:
    session, path = left
    assert is_session(path)
    again = read_session(path)
    assert again.recordings == [ROOM]
    assert again.config == session.config
    one, other = (some.slam_state.copy().mapper for some in (session, again))
    for before, after in zip(estimate(one), estimate(other), strict=True):
        np.testing.assert_allclose(after, before, rtol=1e-3, atol=1e-4)  # iSAM2 substitutes back to a threshold
    one.converge()
    other.converge()
    for before, after in zip(estimate(one), estimate(other), strict=True):
        np.testing.assert_allclose(after, before, rtol=1e-6, atol=1e-6)  # both are a micrometre from rest


def test_all_that_the_estimate_rests_on_is_read_back(left: tuple[StoredSession, Path]) -> None:
    session, path = left
    again = read_session(path)
    one, other = session.slam_state, again.slam_state
    for name in ("walls", "corners"):
        before, after = (getattr(some.mapper.landmarks, name).rows for some in (one, other))
        for column in before.dtype.landmark_ids:
            # of a covariance only one half is kept, and the two agree but for rounding
            np.testing.assert_allclose(after[column], before[column], rtol=1e-9, atol=1e-15, err_msg=column)
    assert other.mapper.landmarks.covered == one.mapper.landmarks.covered
    assert other.mapper.landmarks.opened == one.mapper.landmarks.opened
    assert other.mapper.free_space_evidence.counts == one.mapper.free_space_evidence.counts
    assert other.mapper.roughness.variance == one.mapper.roughness.variance
    np.testing.assert_array_equal(other.odometry_model.deviations, one.odometry_model.deviations)
    for before, after in zip(one.mapper.landmark_ids, other.mapper.landmark_ids, strict=True):
        np.testing.assert_array_equal(after.walls, before.walls)
        np.testing.assert_array_equal(after.corners, before.corners)
    covariances = one.mapper.pose_covariances
    np.testing.assert_allclose(other.mapper.pose_covariances, covariances, rtol=1e-9, atol=1e-15)
    assert len(other.mapper.unconfirmed_observations) == len(one.mapper.unconfirmed_observations)
    np.testing.assert_array_equal(other.mapper.travelled, one.mapper.travelled)
    np.testing.assert_allclose(other.pose, one.pose, atol=1e-12)
    np.testing.assert_array_equal(again.odometry[0].stamps, session.odometry[0].stamps)
    np.testing.assert_array_equal(again.odometry[0].poses, session.odometry[0].poses)


def test_what_was_sighted_is_read_back(left: tuple[StoredSession, Path]) -> None:
    session, path = left
    drive, again = session.scan_history(), read_session(path).scan_history()
    np.testing.assert_array_equal(again.stamps, drive.stamps)
    np.testing.assert_array_equal(again.odometry, drive.odometry)
    np.testing.assert_array_equal(again.keyframes, drive.keyframes)
    np.testing.assert_array_equal(again.anchors, drive.anchors)
    np.testing.assert_array_equal(again.relative, drive.relative)
    np.testing.assert_array_equal(again.has_features, drive.has_features)
    for before, after in zip(drive.scans, again.scans, strict=True):
        for some in (before.features, after.features):  # else what is compiled for the one would be compiled for the other anew
            arrays = some.segments.frame, some.segments.half_length, some.segments.covariance, some.corners.covariance
            assert all(array.flags.c_contiguous for array in (*arrays, some.corners.position, some.corners.headings))
        np.testing.assert_allclose(after.features.segments.frame, before.features.segments.frame, atol=1e-6)
        np.testing.assert_allclose(after.features.segments.covariance, before.features.segments.covariance, rtol=1e-6)
        np.testing.assert_allclose(after.features.corners.position, before.features.corners.position, atol=1e-6)
        np.testing.assert_array_equal(after.features.corners.segments, before.features.corners.segments)
        np.testing.assert_allclose(se2.wrap(after.features.corners.headings - before.features.corners.headings), 0, atol=1e-6)
        np.testing.assert_allclose(after.features.points.all, before.features.points.all, atol=6e-4)
        np.testing.assert_allclose(after.features.points.clutter, before.features.points.clutter, atol=6e-4)
    for row in drive.keyframes[-5:]:  # which the next scans will be laid over
        before, after = drive.scans[row].features, again.scans[row].features
        np.testing.assert_array_equal(after.segments.frame, before.segments.frame)
        np.testing.assert_array_equal(after.points.clutter, before.points.clutter)


def test_a_session_is_small(left: tuple[StoredSession, Path]) -> None:
    session, path = left
    size = (path / SESSION / SIGHTINGS).stat().st_size
    assert size < 2500 * len(session.scans)  # 360 points and some twelve features a scan


def test_what_was_not_kept_of_a_sighting_is_not_there_afterwards(tmp_path: Path) -> None:
    slam = Slam()
    for message in Simulation("room", seed=3, duration=2.0):
        slam.add(message)
    slam.finish()
    session = slam.session
    last = len(session.scans) - 1
    session.scans = [*session.scans[:last], session.scans[last].without_view()]
    leave(tmp_path, session)
    again = read_session(tmp_path)
    assert again.scans[last].features is NO_FEATURES
    assert again.scan_history().has_features.sum() == last


def test_a_directory_of_an_older_version_says_so(tmp_path: Path) -> None:
    assert not is_session(tmp_path)
    with pytest.raises(MapError, match=r"holds no session/session.json, so it cannot be gone on from"):
        read_session(tmp_path)
    with pytest.raises(MapError, match="is not a directory"):
        read_session(tmp_path / "nowhere")


def test_a_session_that_knows_of_no_retired_walls_is_read(left: tuple[StoredSession, Path], tmp_path: Path) -> None:
    """As version 1 left it."""
    path = shutil.copytree(left[1], tmp_path / "out")
    head, walls = path / SESSION / HEAD, path / SESSION / WALLS
    head.write_text(json.dumps(json.loads(head.read_text()) | {"version": 1}))
    new = ["removed_at", "opened", "opened_at", "doubted", "doubts"]
    pq.write_table(pq.read_table(walls).drop_columns(new), walls)
    mapper = read_session(path).slam_state.mapper
    assert (mapper.landmarks.walls.rows["removed_at"] == NEVER_REMOVED).all()
    assert len(mapper.landmarks.walls) == len(left[0].slam_state.mapper.landmarks.walls)
    assert not mapper.landmarks.opened
    assert not mapper.free_space_evidence.counts


def test_a_session_that_does_not_know_where_it_was_adrift_is_read(
    left: tuple[StoredSession, Path], tmp_path: Path
) -> None:
    """As version 2 left it."""
    path = shutil.copytree(left[1], tmp_path / "out")
    head, keyframes = path / SESSION / HEAD, path / SESSION / KEYFRAMES
    head.write_text(json.dumps(json.loads(head.read_text()) | {"version": 2}))
    pq.write_table(pq.read_table(keyframes).drop_columns(list(ADRIFT)), keyframes)
    mapper = read_session(path).slam_state.mapper
    assert mapper.correlated_drift.shape == (mapper.keyframe_count, 2, 2)
    assert not mapper.correlated_drift.any()


def test_a_session_of_another_version_says_so(left: tuple[StoredSession, Path], tmp_path: Path) -> None:
    path = shutil.copytree(left[1], tmp_path / "out")
    head = path / SESSION / HEAD
    head.write_text(json.dumps(json.loads(head.read_text()) | {"version": 99}))
    with pytest.raises(MapError, match=r"session.json: is a session of version 99; this program reads version 1"):
        read_session(path)


@pytest.mark.parametrize(
    ("instead", "told"),
    [
        ({"kidnapped_keyframes": [10**6]}, "carried_keyframes: there are"),
        ({"starts": [-1]}, "starts: there are"),
        ({"sigma": 1}, "sigma: Extra inputs are not permitted"),
        ({"fit": None}, "fit: Input should be a valid number"),
    ],
)
def test_a_head_that_cannot_be_is_refused(
    left: tuple[StoredSession, Path], tmp_path: Path, instead: dict[str, object], told: str
) -> None:
    path = shutil.copytree(left[1], tmp_path / "out")
    head = path / SESSION / HEAD
    head.write_text(json.dumps(json.loads(head.read_text()) | instead))
    with pytest.raises(MapError, match=f"session.json: {told}"):
        read_session(path)


@pytest.mark.parametrize("name", [SIGHTINGS, FACTORS, WALLS])
def test_a_table_that_is_missing_or_another_is_named(
    left: tuple[StoredSession, Path], tmp_path: Path, name: str
) -> None:
    path = shutil.copytree(left[1], tmp_path / "out")
    table = path / SESSION / name
    table.unlink()
    with pytest.raises(MapError, match=f"{name}: is not there; the session is not complete"):
        read_session(path)
    shutil.copy(left[1] / SESSION / "odometry.parquet", table)
    with pytest.raises(MapError, match=f"{name}: is not the table"):
        read_session(path)


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    which=st.integers(0, 99), where=st.floats(0.0, 1.0), cut=st.booleans(), garbage=st.binary(min_size=8, max_size=8)
)
def test_damage_is_an_error_of_one_line(
    left: tuple[StoredSession, Path],
    tmp_path_factory: pytest.TempPathFactory,
    which: int,
    where: float,
    cut: bool,
    garbage: bytes,
) -> None:
    """Whatever is overwritten or cut off: the session is read, or refused in one line."""
    path = shutil.copytree(left[1], tmp_path_factory.mktemp("damaged") / "out")
    files = sorted((path / SESSION).iterdir())
    file = files[which % len(files)]
    content = bytearray(file.read_bytes())
    start = int(where * (len(content) - 1))
    if cut:
        content = content[:start]
    else:
        content[start : start + 8] = garbage
    file.write_bytes(content)
    told = ""
    try:
        read_session(path)
    except SlamError as error:
        told = str(error)
    assert "\n" not in told
