"""A session that contradicts what holds for every session is refused before anything is computed from it."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from slam.errors import MapError
from slam.io.output_dir import SESSION
from slam.io.sessions import read_session

from .damage import change_column, change_header, change_rows, copy_of

TRACKER, FIELD, ANCHOR = (["checkpoint", name] for name in ("tracker", "field", "anchor"))
HEADERS: list[tuple[list[Any], Callable[[Any], Any], str]] = [
    ([*FIELD, "inserted"], lambda old: old[:-1], "does not have a pose for each keyframe that was inserted"),
    ([*FIELD, "inserted"], lambda old: [*old[:-1], old[0]], "does not have a pose for each keyframe that was inserted"),
    ([*FIELD, "inserted_poses"], lambda old: old[:-1], "does not have a pose for each keyframe that was inserted"),
    ([*FIELD, "gaps"], lambda old: [[10**6, 1.0]], "checkpoint.field: there are"),
    ([*FIELD, "centre"], lambda old: [1e6, 0.0], "checkpoint.field: is farther away than the robot can have driven"),
    ([*TRACKER, "fix", "pose", 0], lambda old: 1e6, "checkpoint.tracker: is farther away than the robot can have"),
    ([*TRACKER, "fix", "odometry", 0], lambda old: 1e6, "an odometry pose .* is far from all readings"),
    ([*TRACKER, "reference", "odometry", 1], lambda old: -1e6, "an odometry pose .* is far from all readings"),
    ([*TRACKER, "velocity", 0], lambda old: 1e6, "checkpoint.tracker.velocity.0: input should be less than"),
    ([*TRACKER, "velocity_variances", 0], lambda old: -1.0, "checkpoint.tracker.velocity_variances.0: input should be"),
    ([*TRACKER, "scan_stamp"], lambda old: 1e9, "checkpoint.tracker: the last scan is later than all scans"),
    (ANCHOR, lambda old: None, "checkpoint.anchor: must be stated if and only if there are keyframes"),
    ([*ANCHOR, "covariance", 2, 2], lambda old: -1.0, "checkpoint.anchor.covariance: is no covariance"),
    ([*ANCHOR, "covariance", 2, 2], lambda old: 1e14, "checkpoint.anchor.covariance: is no covariance"),
    (
        ["agreement", "places"],
        lambda old: [{"centre": 0, "keyframes": [0, 1], "poses": [[0.0, 0.0, 0.0]]}],
        "agreement.places.0: has 1 poses of 2 keyframes",
    ),
    (["agreement", "candidates"], lambda old: -1, "agreement.candidates: input should be greater than or equal to 0"),
    (["graph", "range_bias"], lambda old: 1e6, "graph.range_bias: input should be less than 1000"),
    (["segment_starts"], lambda old: [], "segment_starts: these are not the starts of 1 odometry segments"),
    (["segment_starts"], lambda old: [*old, 3], "segment_starts: these are not the starts of 1 odometry segments"),
    (["segment_starts"], lambda old: [3], "segment_starts: these are not the starts of 1 odometry segments"),
]


@pytest.mark.parametrize(("keys", "change", "message"), HEADERS)
def test_a_header_that_contradicts_itself_or_the_tables_is_refused(
    intact: Path, tmp_path: Path, keys: list[Any], change: Callable[[Any], Any], message: str
) -> None:
    path = copy_of(intact, tmp_path)
    change_header(path, keys, change)
    refused(path, rf"session\.json: .*{message}")


ROWS: list[tuple[str, Callable[[list[int]], list[int]], str]] = [
    ("scans", lambda rows: [*rows[:2], rows[3], rows[2], *rows[4:]], "the scans are not in time order"),
    ("odometry", lambda rows: [], "segment_starts: these are not the starts of 0 odometry segments"),
    ("recent_keyframes", lambda rows: rows[1:], "does not belong to the same session as the table of scans"),
    ("recent_keyframes", lambda rows: rows[::-1], "does not belong to the same session as the table of scans"),
    ("variables", lambda rows: [*rows, rows[-1]], "has a .* twice, or not in the order of their numbers"),
]


@pytest.mark.parametrize(("table", "change", "message"), ROWS)
def test_a_table_with_missing_repeated_or_exchanged_rows_is_refused(
    intact: Path, tmp_path: Path, table: str, change: Callable[[list[int]], list[int]], message: str
) -> None:
    path = copy_of(intact, tmp_path)
    change_rows(path / SESSION / f"{table}.parquet", change)
    refused(path, message)


VALUES: list[tuple[str, str, Any, str]] = [
    ("keyframes", "x", 1e6, "a keyframe is farther away than the robot can have driven"),
    ("corners", "in_graph", False, r"the corner \d+ is a variable of the graph, but is not confirmed"),
    ("walls", "in_graph", False, r"the wall \d+ is a variable of the graph, but is not confirmed"),
    ("walls", "first_seen", -1, "a landmark was seen in a keyframe that does not exist"),
    ("walls", "heading_heading", 1e12, r"the column heading_heading has values beyond 1e\+10"),
    ("scans", "odometry_x", 1e6, "an odometry pose .* is far from all readings"),
    ("scans", "anchor", 10**6, "the pose of a scan is relative to a later keyframe"),
    ("scans", "relative_x", 1e6, "a scan is farther from its keyframe than the robot can have driven"),
    ("scans", "information_xx", -1.0, "the information of a pose is negative"),
    ("scans", "information_xy", 1e12, "the information of a pose is negative"),
    ("scans", "segment_half_length", 1e-12, "a segment is shorter than 0.002 m"),
    ("scans", "segment_half_length", 1e9, "the column segment_half_length has values beyond 100000"),
    ("recent_keyframes", "segment_heading", 0.5, "does not belong to the same session as the table of scans"),
    ("factors", "measured", 1e12, r"the column measured has values beyond 1e\+10"),
    ("factors", "covariance", 1e14, "the covariance of a factor is not positive definite"),
    ("variables", "heading", 1e12, r"the column heading has values beyond 1e\+10"),
]


@pytest.mark.parametrize(("table", "column", "value", "message"), VALUES)
def test_a_value_that_no_session_has_is_refused(
    intact: Path, tmp_path: Path, table: str, column: str, value: Any, message: str
) -> None:
    path = copy_of(intact, tmp_path)
    change_column(path / SESSION / f"{table}.parquet", column, value)
    refused(path, message)


def refused(path: Path, message: str) -> None:
    """Check that a session is refused with a message of one line."""
    with pytest.raises(MapError) as caught:
        read_session(path)
    assert re.search(message, str(caught.value)), str(caught.value)
    assert "\n" not in str(caught.value)
