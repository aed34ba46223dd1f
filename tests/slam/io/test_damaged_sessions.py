"""A session that is damaged, or whose parts do not fit together, is refused with an error of one line."""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from slam.errors import MapError, SlamError
from slam.graph.factors import FactorKind
from slam.io.output_dir import SESSION
from slam.io.sessions import is_session, read_session
from slam.io.sessions.session import FACTORS, HEADER, KEYFRAMES, SCANS, WALLS
from slam.io.sessions.tables import TableReader, to_ragged, write_table

from .damage import change_column, change_header

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
# Hypothesis of loop closure in `session.json`.
HYPOTHESIS = {"motion": [0.0, 0.0, 0.0], "support": [MATCH], "contradictions": []}


def test_directory_without_session_is_refused(tmp_path: Path) -> None:
    assert not is_session(tmp_path)
    with pytest.raises(MapError, match=r"has no session/session.json, so it cannot be continued, refined or corrected"):
        read_session(tmp_path)
    with pytest.raises(MapError, match="no such directory"):
        read_session(tmp_path / "nowhere")


@pytest.mark.parametrize("version", [4, 8, 10, None, "8\n"])
def test_session_of_another_version_is_refused(intact: Path, tmp_path: Path, version: object) -> None:
    path = shutil.copytree(intact, tmp_path / "out")
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
        (["checkpoint", "tracker", "moved_objects"], 10**6, "checkpoint.tracker: more small objects have moved"),
        (["checkpoint", "tracker", "after_slips"], 10**6, "checkpoint.tracker: the numbers of scans"),
        (["checkpoint", "tracker", "repeated_slips"], 10**6, "checkpoint.tracker: the numbers of scans"),
        (["checkpoint", "tracker", "last_score"], None, "checkpoint.tracker.last_score: input should be a"),
        (["segment_starts"], [-1], "segment_starts: these are"),
        (["agreement", "hypotheses"], [HYPOTHESIS | {"support": [MATCH | {"old": 10**6}]}], "agreement: there are"),
        (
            ["agreement", "hypotheses"],
            [HYPOTHESIS | {"support": [MATCH | {"covariance": [[0.0] * 3] * 3}]}],
            "agreement.hypotheses.0.support",
        ),
        (["agreement", "hypotheses"], [HYPOTHESIS | {"support": []}], "agreement.hypotheses.0.support"),
        (["sigma"], 1, "sigma: extra inputs are not permitted"),
    ],
)
def test_header_with_an_invalid_value_is_refused(
    intact: Path, tmp_path: Path, keys: list[str], value: Any, message: str
) -> None:
    path = shutil.copytree(intact, tmp_path / "out")
    change_header(path, keys, lambda _: value)
    with pytest.raises(MapError, match=f"session.json: {message}"):
        read_session(path)


@pytest.mark.parametrize("name", [SCANS, FACTORS, WALLS])
def test_missing_or_wrong_table_is_named(intact: Path, tmp_path: Path, name: str) -> None:
    path = shutil.copytree(intact, tmp_path / "out")
    table = path / SESSION / name
    table.unlink()
    with pytest.raises(MapError, match=f"{name}: file is missing; the session is incomplete"):
        read_session(path)
    shutil.copy(intact / SESSION / "odometry.parquet", table)
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
    intact: Path,
    tmp_path_factory: pytest.TempPathFactory,
    which: int,
    position: float,
    truncate: bool,
    garbage: bytes,
) -> None:
    """If a file is overwritten in part or truncated, the session is read, or refused with an error of one line."""
    path = shutil.copytree(intact, tmp_path_factory.mktemp("damaged") / "out")
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
    (SCANS, "sweep_covariance", -1.0, "a sweep covariance has a negative variance"),
    (SCANS, "point_sigma", -1.0, "a standard deviation of points is negative"),
    (WALLS, "x", 1e300, "the column x has values beyond 1e\\+10"),
    (WALLS, "high", 1e15, "a wall has an end that is not within 100000 m"),
    (WALLS, "low", float("-inf"), "a wall has an end that is not within 100000 m"),
    (WALLS, "low", float("nan"), "a wall has an end that is not within 100000 m"),
]


@pytest.mark.parametrize(("name", "column", "value", "message"), CHANGES)
def test_values_that_do_not_fit_together_are_refused(
    intact: Path,
    tmp_path: Path,
    name: str,
    column: str,
    value: Any,
    message: str,
) -> None:
    path = shutil.copytree(intact, tmp_path / "out")
    change_column(path / SESSION / name, column, value)
    with pytest.raises(MapError, match=message) as caught:
        read_session(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["wall", "corner"])
def test_a_landmark_of_the_graph_without_a_variable_is_refused(intact: Path, tmp_path: Path, kind: str) -> None:
    path = shutil.copytree(intact, tmp_path / "out")
    file = path / SESSION / "variables.parquet"
    table = pq.read_table(file)
    confirmed = table.filter(pc.not_equal(table.column("kind"), kind)).replace_schema_metadata(table.schema.metadata)
    pq.write_table(confirmed, file)
    with pytest.raises(MapError, match=rf"the {kind} \d+ is confirmed, but is no variable of the graph"):
        read_session(path)


def test_a_noise_of_bearings_of_more_than_half_a_turn_is_refused(intact: Path, tmp_path: Path) -> None:
    header = shutil.copytree(intact, tmp_path / "out") / SESSION / HEADER
    data = json.loads(header.read_text())
    data["sensor_models"]["sigma_bearing"] = 2**31
    header.write_text(json.dumps(data))
    with pytest.raises(MapError, match=r"sensor_models.sigma_bearing: input should be less than or equal to 3.14"):
        read_session(tmp_path / "out")


@pytest.mark.parametrize("value", [0.0, -0.01])
def test_a_range_without_noise_is_refused(intact: Path, tmp_path: Path, value: float) -> None:
    path = shutil.copytree(intact, tmp_path / "out")
    header = path / SESSION / HEADER
    data = json.loads(header.read_text())
    data["sensor_models"]["sigma_range"] = value
    header.write_text(json.dumps(data))
    with pytest.raises(MapError, match=r"sensor_models.sigma_range: input should be greater than 0"):
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


@pytest.mark.slow
def test_no_damage_of_a_footer_ends_the_process(tmp_path: Path) -> None:
    path = tmp_path / "table.parquet"
    write_table(path, {"a": np.arange(20.0), "b": to_ragged([np.arange(3.0)] * 20, np.float64)})
    result = subprocess.run([sys.executable, "-c", DAMAGE, str(path)], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


Factor = dict[str, Any]


def refuses_factors(intact: Path, path: Path, change: Callable[[list[Factor]], None], message: str) -> None:
    """Check that a copy of a session is refused with a message after a change of its factors."""
    file = shutil.copytree(intact, path) / SESSION / FACTORS
    table = pq.read_table(file)
    factors = table.to_pylist()
    change(factors)
    pq.write_table(pa.Table.from_pylist(factors, table.schema), file)
    with pytest.raises(MapError, match=f"factors.parquet: {message}"):
        read_session(path)


def test_odometry_that_leads_back_is_refused(intact: Path, tmp_path: Path) -> None:
    """The drift is followed along odometry to the first keyframe; in a circle that would never end."""

    def turn_back(factors: list[Factor]) -> None:
        last = [factor for factor in factors if factor["kind"] == FactorKind.ODOMETRY][-1]
        last["first"], last["second"] = last["second"], last["first"]

    refuses_factors(intact, tmp_path / "out", turn_back, r"odometry leads from the keyframe \d+ back to \d+")


@pytest.mark.parametrize("kind", [FactorKind.POSE_PRIOR, FactorKind.POINT_MAP])
def test_a_factor_of_one_keyframe_with_another_one_that_does_not_exist_is_refused(
    intact: Path, tmp_path: Path, kind: FactorKind
) -> None:
    def change(factors: list[Factor]) -> None:
        next(factor for factor in factors if factor["kind"] == kind)["second"] = 10**6

    message = rf"a factor of kind {kind} from \d+ to 1000000 has a variable that does not exist"
    refuses_factors(intact, tmp_path / "out", change, message)


@pytest.mark.parametrize("kind", ["wall", "corner"])
def test_a_landmark_without_factors_is_refused(intact: Path, tmp_path: Path, kind: str) -> None:
    """Nothing determines it."""

    def remove(factors: list[Factor]) -> None:
        of_kind = {"wall": ("gauge_prior", "wall_heading", "wall_offset"), "corner": ("corner",)}[kind]
        factors[:] = [factor for factor in factors if factor["kind"] not in of_kind or factor["second"]]

    refuses_factors(intact, tmp_path / "out", remove, f"no factor has the {kind} 0")


def test_a_landmark_that_waits_although_all_keyframes_are_solved_is_refused(intact: Path, tmp_path: Path) -> None:
    """The last factors wait; with another number of them the landmark would have no estimate."""

    def begin_with_a_corner_last(factors: list[Factor]) -> None:
        confirmed = [factor for factor in factors if not factor["unconfirmed"]]
        corner = max(factor["second"] for factor in confirmed if factor["kind"] == FactorKind.CORNER)
        waiting = [f for f in confirmed if f["kind"] == FactorKind.CORNER and f["second"] == corner]
        rest = [factor for factor in confirmed if factor not in waiting]
        factors[:] = [*rest, *waiting, *(factor for factor in factors if factor["unconfirmed"])]
        header = tmp_path / "out" / SESSION / HEADER
        data = json.loads(header.read_text())
        data["graph"]["waiting"] = len(waiting)
        header.write_text(json.dumps(data))

    message = r"the corner \d+ waits for a solution, but no keyframe does"
    refuses_factors(intact, tmp_path / "out", begin_with_a_corner_last, message)
