"""A session is read back as it was written, or refused with an error of one line."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers import se2
from drivers.simulation import Simulation
from features import LearnedNoise
from slam import Slam
from slam.config import Config, LidarConfig, config_to_toml
from slam.errors import MapError, SlamError
from slam.graph.factors import FactorKind
from slam.graph.graph_storage import graph_state
from slam.io.output_dir import CONFIG, SESSION
from slam.io.sessions import Recording, StoredSession, is_session, read_session, write_session
from slam.io.sessions.session import FACTORS, HEADER, KEYFRAMES, SCANS, WALLS
from slam.io.sessions.tables import TableReader, to_ragged, write_table
from slam.loop_closure.decision import LoopMatch
from slam.loop_closure.loop_hypothesis import LoopAgreementState, LoopHypothesis, OldPlace
from slam.mapping.convergence import converge
from slam.mapping.mapper import Mapper
from slam.preprocessing.preprocessor import NO_FEATURES
from slam.preprocessing.scan_sequence import ScanSequence

# Match of keyframes in `session.json`.
MATCH = {
    "keyframe": 3,
    "old": 1,
    "relative": [0.1, 0.0, 0.02],
    "covariance": [[0.01, 0.001, 0.0], [0.001, 0.02, 0.0], [0.0, 0.0, 0.001]],
    "travelled": 1.5,
    "fit": 0.9,
    "known": 0.8,
}
ROOM = Recording(name="room", path="sim:room", first=0.0, last=8.0)


def write_directory(directory: Path, session: StoredSession) -> None:
    directory.mkdir(exist_ok=True)
    (directory / CONFIG).write_text(config_to_toml(session.config))
    write_session(directory, session)


@pytest.fixture(scope="module", params=[False, True], ids=["online", "refined"])
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[StoredSession, Path]:
    slam = Slam(Config(), refine=request.param)
    for message in Simulation("room", seed=3, duration=8.0):
        slam.add(message)
    slam.finish()
    session = slam.session
    session.recordings.append(ROOM)
    path = tmp_path_factory.mktemp("run") / "out"
    write_directory(path, session)
    return session, path


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
    assert state.mapper.roughness.variance == expected.mapper.roughness.variance
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
    hypotheses = [LoopHypothesis(random.normal(size=3), [match], [0.5]), LoopHypothesis(random.normal(size=3), [match])]
    expected = LoopAgreementState(
        1.75, [(1, place)], [(1, 1.5)], [0.25, 0.75], hypotheses[0], hypotheses[1:], 3, [np.ones(3)]
    )
    state.loops.restore(expected, state.local_field)
    write_directory(tmp_path / "out", session)
    restored = read_session(tmp_path / "out").slam_state.loops.state
    assert (restored.last_search, list(restored.returns)) == (1.75, [0.25, 0.75])
    assert (list(restored.searched), restored.candidates) == ([(1, 1.5)], 3)
    np.testing.assert_array_equal(restored.retracted, [np.ones(3)])
    ((centre, same),) = restored.places
    assert centre == 1
    np.testing.assert_array_equal(same.keyframes, place.keyframes)
    np.testing.assert_array_equal(same.poses, place.poses)
    assert len(restored.hypotheses) == 1
    for before, after in zip(hypotheses, (restored.estimate, *restored.hypotheses), strict=True):
        np.testing.assert_array_equal(after.motion, before.motion)
        assert after.contradictions == before.contradictions
        (saved,) = after.support
        for name in LoopMatch.__slots__:
            np.testing.assert_array_equal(getattr(saved, name), getattr(match, name), err_msg=name)


def test_scans_are_read_back(written: tuple[StoredSession, Path]) -> None:
    session, path = written
    expected, history = session.scan_history(), read_session(path).scan_history()
    np.testing.assert_array_equal(history.stamps, expected.stamps)
    np.testing.assert_array_equal(history.odometry, expected.odometry)
    np.testing.assert_array_equal(history.keyframes, expected.keyframes)
    np.testing.assert_array_equal(history.anchors, expected.anchors)
    np.testing.assert_array_equal(history.relative, expected.relative)
    np.testing.assert_array_equal(history.has_features, expected.has_features)
    for before, after in ((b.features, a.features) for b, a in zip(expected.scans, history.scans, strict=True)):
        np.testing.assert_allclose(after.segments.frame, before.segments.frame, atol=1e-6)
        np.testing.assert_allclose(after.segments.covariance, before.segments.covariance, rtol=1e-6)
        np.testing.assert_allclose(after.corners.position, before.corners.position, atol=1e-6)
        np.testing.assert_array_equal(after.corners.segments, before.corners.segments)
        np.testing.assert_allclose(se2.wrap(after.corners.headings - before.corners.headings), 0, atol=1e-6)
        np.testing.assert_allclose(after.points.xy, before.points.xy, atol=6e-4)
    for row in expected.keyframes[-5:]:  # the next scans will be matched to these
        before, after = expected.scans[row].features, history.scans[row].features
        np.testing.assert_array_equal(after.segments.frame, before.segments.frame)
        np.testing.assert_array_equal(after.points.xy, before.points.xy)


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


def test_session_is_small(written: tuple[StoredSession, Path]) -> None:
    session, path = written
    size = (path / SESSION / SCANS).stat().st_size
    assert size < 2500 * len(session.scans)  # 360 points and some twelve features per scan


def test_scan_without_features_is_read_back_without_features(tmp_path: Path) -> None:
    slam = Slam()
    for message in Simulation("room", seed=3, duration=2.0):
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


def test_directory_without_session_is_refused(tmp_path: Path) -> None:
    assert not is_session(tmp_path)
    with pytest.raises(MapError, match=r"has no session/session.json, so it cannot be continued or refined"):
        read_session(tmp_path)
    with pytest.raises(MapError, match="no such directory"):
        read_session(tmp_path / "nowhere")


@pytest.mark.parametrize("version", [4, 8, 10, None, "8\n"])
def test_session_of_another_version_is_refused(
    written: tuple[StoredSession, Path], tmp_path: Path, version: object
) -> None:
    path = shutil.copytree(written[1], tmp_path / "out")
    header = path / SESSION / HEADER
    header.write_text(json.dumps(json.loads(header.read_text()) | {"version": version}))
    stated = re.escape(repr(version))
    with pytest.raises(
        MapError, match=rf"session.json: has format version {stated}; this program reads version 9 only"
    ):
        read_session(path)


@pytest.mark.parametrize(
    ("keys", "value", "message"),
    [
        (["checkpoint", "kidnapped_keyframes"], [10**6], "checkpoint.kidnapped_keyframes: there are"),
        (["checkpoint", "tracker", "slips"], 10**6, "checkpoint.tracker: more slips than scans"),
        (["checkpoint", "tracker", "after_slips"], 10**6, "checkpoint.tracker: the numbers of scans"),
        (["checkpoint", "tracker", "repeated_slips"], 10**6, "checkpoint.tracker: the numbers of scans"),
        (["checkpoint", "tracker", "last_score"], None, "checkpoint.tracker.last_score: Input should be a"),
        (["segment_starts"], [-1], "segment_starts: there are"),
        (["agreement", "estimate", "support"], [MATCH | {"old": 10**6}], "agreement: there are"),
        (["agreement", "estimate", "support"], [MATCH | {"covariance": [[0.0] * 3] * 3}], "agreement.estimate.support"),
        (["agreement", "hypotheses"], [{"motion": [0.0] * 3, "support": [], "contradictions": []}], "agreement.hypoth"),
        (["sigma"], 1, "sigma: Extra inputs are not permitted"),
    ],
)
def test_header_with_an_invalid_value_is_refused(
    written: tuple[StoredSession, Path], tmp_path: Path, keys: list[str], value: Any, message: str
) -> None:
    path = shutil.copytree(written[1], tmp_path / "out")
    header = path / SESSION / HEADER
    data = record = json.loads(header.read_text())
    for key in keys[:-1]:
        record = record[key]
    record[keys[-1]] = value
    header.write_text(json.dumps(data))
    with pytest.raises(MapError, match=f"session.json: {message}"):
        read_session(path)


@pytest.mark.parametrize("name", [SCANS, FACTORS, WALLS])
def test_missing_or_wrong_table_is_named(written: tuple[StoredSession, Path], tmp_path: Path, name: str) -> None:
    path = shutil.copytree(written[1], tmp_path / "out")
    table = path / SESSION / name
    table.unlink()
    with pytest.raises(MapError, match=f"{name}: file is missing; the session is incomplete"):
        read_session(path)
    shutil.copy(written[1] / SESSION / "odometry.parquet", table)
    with pytest.raises(MapError, match=f"{name}: is not the table"):
        read_session(path)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    which=st.integers(0, 99),
    position=st.floats(0.0, 1.0),
    truncate=st.booleans(),
    garbage=st.binary(min_size=8, max_size=8),
)
def test_damage_is_an_error_of_one_line(
    written: tuple[StoredSession, Path],
    tmp_path_factory: pytest.TempPathFactory,
    which: int,
    position: float,
    truncate: bool,
    garbage: bytes,
) -> None:
    """If a file is overwritten in part or truncated, the session is read, or refused with an error of one line."""
    path = shutil.copytree(written[1], tmp_path_factory.mktemp("damaged") / "out")
    files = sorted((path / SESSION).iterdir())
    file = files[which % len(files)]
    content = bytearray(file.read_bytes())
    start = int(position * (len(content) - 1))
    if truncate:
        content = content[:start]
    else:
        content[start : start + 8] = garbage
    file.write_bytes(content)
    message = ""
    try:
        read_session(path)
    except SlamError as error:
        message = str(error)
    assert "\n" not in message


CHANGES: list[tuple[str, str, Any, str]] = [
    (FACTORS, "first", -1, "has a variable that does not exist"),
    (FACTORS, "second", 10**6, "has a variable that does not exist"),
    (FACTORS, "covariance", 0.0, "the covariance of a factor is not positive definite"),
    (FACTORS, "kind", "", "unknown kind of factor: ''"),
    (KEYFRAMES, "xx", -1.0, "the covariance of a pose has a negative variance"),
    (KEYFRAMES, "xh", 1.0, "the covariance of a pose has a negative variance"),
    (KEYFRAMES, "correlated_drift_xy", 1.0, "the correlated drift of a keyframe is less than that of the one before"),
    (WALLS, "map_offset_offset", -1.0, "walls.parquet: the covariance of a landmark has a negative variance"),
    ("corners.parquet", "xy", 1.0, "corners.parquet: the covariance of a landmark has a negative variance"),
    (WALLS, "first_seen", 10**6, "a landmark was seen in a keyframe that does not exist"),
    (WALLS, "merged_into", -(10**6), "a landmark refers to a wall that does not exist"),
    ("corners.parquet", "wall_before", 10**6, "a landmark refers to a wall that does not exist"),
    ("corners.parquet", "last_seen", 10**6, "a landmark was seen in a keyframe that does not exist"),
    (KEYFRAMES, "travelled", -1.0, "the travelled distance decreases"),
    ("variables.parquet", "id", 10**6, "(the keyframes are not in order|does not exist)"),
    (SCANS, "segment_offset_offset", -1.0, "the covariance of a segment is not positive definite"),
    (SCANS, "segment_offset_offset", 1e-300, "the covariance of a segment is not positive definite"),
    (WALLS, "x", 1e300, "the column x has values beyond 1e\\+15"),
    (WALLS, "high", 1e15, "a wall has an end that is not within 100000 m"),
    (WALLS, "low", float("-inf"), "a wall has an end that is not within 100000 m"),
    (WALLS, "low", float("nan"), "a wall has an end that is not within 100000 m"),
]


@pytest.mark.parametrize(("name", "column", "value", "message"), CHANGES)
def test_values_that_do_not_fit_together_are_refused(
    written: tuple[StoredSession, Path],
    tmp_path: Path,
    name: str,
    column: str,
    value: Any,
    message: str,
) -> None:
    path = shutil.copytree(written[1], tmp_path / "out")
    change_column(path / SESSION / name, column, value)
    with pytest.raises(MapError, match=message) as caught:
        read_session(path)
    assert "\n" not in str(caught.value)


def change_column(file: Path, name: str, value: Any) -> None:
    """Replace the last value of a column, of a list its first value."""
    table = pq.read_table(file)
    column = table.column(name)
    values = column.to_pylist()
    row = max(k for k, v in enumerate(values) if v not in (value, []))
    values[row] = [value, *values[row][1:]] if isinstance(values[row], list) else value
    index = table.column_names.index(name)
    pq.write_table(table.set_column(index, table.schema.field(index), pa.array(values, column.type)), file)


@pytest.mark.parametrize("kind", ["wall", "corner"])
def test_a_landmark_of_the_graph_without_a_variable_is_refused(
    written: tuple[StoredSession, Path], tmp_path: Path, kind: str
) -> None:
    path = shutil.copytree(written[1], tmp_path / "out")
    file = path / SESSION / "variables.parquet"
    table = pq.read_table(file)
    confirmed = table.filter(pc.not_equal(table.column("kind"), kind)).replace_schema_metadata(table.schema.metadata)
    pq.write_table(confirmed, file)
    with pytest.raises(MapError, match=rf"the {kind} \d+ is confirmed, but is no variable of the graph"):
        read_session(path)


def test_odometry_that_leads_back_is_refused(written: tuple[StoredSession, Path], tmp_path: Path) -> None:
    """The drift is followed along odometry to the first keyframe; in a circle that would never end."""
    path = shutil.copytree(written[1], tmp_path / "out")
    file = path / SESSION / FACTORS
    table = pq.read_table(file)
    factors = table.to_pylist()
    last = max(k for k, factor in enumerate(factors) if factor["kind"] == FactorKind.ODOMETRY)
    first, second = factors[last]["first"], factors[last]["second"]
    factors[last] |= {"first": second, "second": first}
    pq.write_table(pa.Table.from_pylist(factors, table.schema), file)
    with pytest.raises(MapError, match=f"factors.parquet: odometry leads from the keyframe {second} back to {first}"):
        read_session(path)


def test_the_noise_of_rays_is_kept(written: tuple[StoredSession, Path], tmp_path: Path) -> None:
    session, path = written[0], shutil.copytree(written[1], tmp_path / "out")
    assert read_session(path).noise == session.noise
    header = path / SESSION / HEADER
    data = json.loads(header.read_text())
    del data["sensor_models"]["sigma_bearing"], data["sensor_models"]["segmentation_range"]
    header.write_text(json.dumps(data))
    sigma_range = session.noise.sigma_range
    assert read_session(path).noise == LearnedNoise(sigma_range, LidarConfig().sigma_bearing, sigma_range)


@pytest.mark.parametrize("value", [0.0, -0.01])
def test_a_range_without_noise_is_refused(written: tuple[StoredSession, Path], tmp_path: Path, value: float) -> None:
    path = shutil.copytree(written[1], tmp_path / "out")
    header = path / SESSION / HEADER
    data = json.loads(header.read_text())
    data["sensor_models"]["sigma_range"] = value
    header.write_text(json.dumps(data))
    with pytest.raises(MapError, match=r"sensor_models.sigma_range: Input should be greater than 0"):
        read_session(path)


def test_a_table_that_is_larger_in_memory_than_any_that_is_written_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "walls.parquet"
    pq.write_table(pa.table({"x": pa.array(np.zeros(20_000_000, np.int8))}), file)
    with pytest.raises(MapError, match=r"walls.parquet: has 20000000 values, which is more than 200 times its size"):
        TableReader(file)


def test_a_footer_that_is_not_utf_8_is_an_error_of_one_line(tmp_path: Path) -> None:
    file = tmp_path / "walls.parquet"
    write_table(file, {"frame_of_the_wall": np.zeros(3)})
    file.write_bytes(file.read_bytes().replace(b"frame_of_the_wall", b"frame_of\xff\xfe\xfdhe_wall"))
    with pytest.raises(MapError, match=r"walls.parquet: ") as caught:
        TableReader(file)
    assert len(str(caught.value).splitlines()) == 1


DAMAGE = """
import sys
from pathlib import Path
from slam.errors import MapError
from slam.io.sessions.tables import TableReader
path = Path(sys.argv[1])
whole = path.read_bytes()
footer = int.from_bytes(whole[-8:-4], "little")
for position in range(len(whole) - 8 - footer, len(whole) - 8):
    for bits in (0x10, 0x01):
        path.write_bytes(whole[:position] + bytes([whole[position] ^ bits]) + whole[position + 1 :])
        try:
            TableReader(path)
        except MapError:
            pass
"""


def test_no_damage_of_a_footer_ends_the_process(tmp_path: Path) -> None:
    path = tmp_path / "table.parquet"
    write_table(path, {"a": np.arange(20.0), "b": to_ragged([np.arange(3.0)] * 20, np.float64)})
    result = subprocess.run([sys.executable, "-c", DAMAGE, str(path)], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
