"""A stored map is corrected from Python as by `wclm correct`."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import slam
from slam.errors import MapError, SlamError
from slam.io.output_dir import MAP, SUMMARY
from slam.io.run_results import read_run_results


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mapped") / "room"
    slam.run("sim:room?duration=10&seed=2&lidar=short").save(path)
    return path


@pytest.fixture
def session(mapped: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(mapped, tmp_path / "room"))


def test_a_wall_is_deleted_as_by_the_command_and_undone(wclm: Any, session: Path, tmp_path: Path) -> None:
    before, walls = (session / MAP).read_bytes(), read_run_results(session).walls.identity
    lines = slam.correct(session, delete_wall=walls[:1], out=tmp_path / "corrected")
    assert lines == wclm("correct", session, "--delete-wall", walls[0]).stdout.replace("room", "corrected").splitlines()
    assert (tmp_path / "corrected" / MAP).read_bytes() == (session / MAP).read_bytes() != before
    assert walls[0] not in read_run_results(session).walls.identity
    slam.correct(session, delete_wall=[int(walls[1])])
    listed = [f"wall {wall} is deleted" for wall in walls[:2]]
    assert [one["text"] for one in json.loads((session / SUMMARY).read_text())["corrections"]] == listed
    assert slam.undo_correction(session)[0] == f"undone: {listed[1]}"
    slam.undo_correction(session)
    assert (session / MAP).read_bytes() == before
    with pytest.raises(MapError, match="has no corrections"):
        slam.undo_correction(session)


@pytest.mark.parametrize(
    ("correction", "problem"),
    [
        ({}, "no correction is stated"),
        ({"delete_wall": [999]}, "no wall 999"),
        ({"delete_wall": [-1]}, "delete_wall: there is no -1"),
        ({"delete_wall": 3}, "delete_wall must be a list of corrections, not int"),
        ({"delete_wall": ["3"]}, "delete_wall must be whole numbers, not str"),
        ({"tie": [3]}, "tie: 3 is no pair"),
        ({"tie": [(0, 1)]}, "cannot be one"),
        ({"forbid_loop": [np.int64(1)]}, "no loop 1"),
        ({"close": [1]}, "no loop 1"),
        ({"close": [(0, 4000)]}, "no keyframe 4000"),
        ({"close": [(1.0, 4000.0)]}, "4000 s: there is no keyframe"),
        ({"close": [(1.0, np.nan)]}, "close: nan is no stamp"),
        ({"close": ["0,20"]}, "close: '0,20' is no pair"),
        ({"pins": "nowhere.csv"}, "nowhere.csv: No such file"),
    ],
)
def test_mistakes_are_one_line_and_change_nothing(session: Path, correction: dict[str, Any], problem: str) -> None:
    files = {file: file.read_bytes() for file in session.rglob("*") if file.is_file()}
    with pytest.raises(SlamError, match=problem) as raised:
        slam.correct(session, **correction)
    assert "\n" not in str(raised.value)
    assert {file: file.read_bytes() for file in session.rglob("*") if file.is_file()} == files
