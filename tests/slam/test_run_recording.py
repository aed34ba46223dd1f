"""A recording is mapped from Python with a session or a plan, as `wclm run` does with the options of the same names."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import slam
from drivers import Odometry, Scan, se2
from drivers.recordings.mcap import McapWriter
from drivers.simulation import LIDAR_MODELS, Simulation
from slam.errors import MapError, SlamError
from slam.io.plans.units import Unit
from slam.io.sessions import read_session
from slam.io.tum import read_tum_poses

FIRST = "sim:room?duration=10&seed=2&lidar=short"
LATER = "sim:room?duration=8&seed=5&lidar=short"
START = [-2.0, -1.5, 0.0]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the output directory of the first drive."""
    path = tmp_path_factory.mktemp("session") / "first"
    slam.run(FIRST).save(path)
    return path


def assert_path_is_that_of(mapped: slam.MappedRecording, directory: Path) -> None:
    stamps, poses = read_tum_poses(directory / "trajectory.tum")
    np.testing.assert_allclose(mapped.stamps, stamps, atol=1e-6)
    np.testing.assert_allclose(mapped.path, poses, atol=1e-6)  # rounded in the file


@pytest.mark.parametrize(
    ("option", "keyword"), [("--continue", "continue_"), pytest.param("--localize", "localize", marks=pytest.mark.slow)]
)
def test_a_session_is_continued_or_localised_on(
    wclm: Any, session: Path, tmp_path: Path, option: str, keyword: str
) -> None:
    assert wclm("run", LATER, option, str(session), "--out", "map", "--no-review").exit_code == 0
    mapped = slam.run(LATER, **{keyword: session})
    assert_path_is_that_of(mapped, tmp_path / "map")
    mapped.save(tmp_path / "saved")
    saved, written = (json.loads((tmp_path / name / "summary.json").read_text()) for name in ("saved", "map"))
    names = ("name", "path", "shift", "settings", "lidars")
    assert [[one[name] for name in names] for one in saved["recordings"]] == [
        [one[name] for name in names] for one in written["recordings"]
    ]
    assert mapped.facts["truth"] == pytest.approx(written["truth"], abs=1e-9, nan_ok=True)
    assert mapped.shift == saved["recordings"][-1]["shift"] > 0.0
    assert (tmp_path / "saved" / "session").exists() == (option == "--continue")
    assert mapped.occupancy().cells.size
    assert mapped.truth is not None
    difference = se2.between(mapped.truth.at(mapped.stamps[-20:]).poses, mapped.path[-20:])
    assert np.hypot(difference[:, 0], difference[:, 1]).max() < 0.05


def test_warnings_are_those_of_wclm_run(wclm: Any, session: Path, tmp_path: Path) -> None:
    assert (
        wclm("run", LATER, "--continue", str(session), "--start=50,50,0", "--out", "map", "--no-review").exit_code == 0
    )
    mapped = slam.run(LATER, continue_=session, start=[50.0, 50.0, 0.0])
    mapped.save(tmp_path / "saved")
    (warning,) = mapped.warnings
    assert warning.startswith("the initial pose is not used: the scan does not fit near it")
    for name in ("saved", "map"):
        assert json.loads((tmp_path / name / "summary.json").read_text())["warnings"] == [warning]


def test_a_continued_session_is_written_and_can_be_continued_again(session: Path, tmp_path: Path) -> None:
    slam.run(LATER, continue_=session).save(tmp_path / "second")
    third = slam.run(FIRST, continue_=tmp_path / "second", start=START)
    third.save(tmp_path / "third")
    recordings = read_session(tmp_path / "third").recordings
    assert [one.path for one in recordings] == [FIRST, LATER, FIRST]
    assert all(later.first > earlier.last for earlier, later in pairwise(recordings))


@pytest.mark.slow
def test_a_plan_is_mapped_with(wclm: Any, session: Path, tmp_path: Path) -> None:
    options = ("--plan", str(session), "--start=-2,-1.5,0")
    assert wclm("run", LATER, *options, "--out", "map", "--no-review").exit_code == 0
    mapped = slam.run(LATER, plan=session, start=START)
    assert_path_is_that_of(mapped, tmp_path / "map")
    mapped.save(tmp_path / "saved")
    saved, written = (json.loads((tmp_path / name / "summary.json").read_text()) for name in ("saved", "map"))
    assert saved["plan"] == written["plan"]
    assert mapped.plan_differences == saved["plan"]["differences"]
    assert {one.name for one in (tmp_path / "saved").glob("plan*")} == {
        one.name for one in (tmp_path / "map").glob("plan*")
    }


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ({"continue_": "a", "localize": "b"}, "only one of these"),
        ({"continue_": "a", "plan": "b"}, "only one of these"),
        ({"start": [0.0, 0.0, 0.0]}, "an initial pose .start. needs a map"),
        ({"plan": "a.dxf", "start": [0.0, 0.0]}, "must be three numbers"),
        ({"plan_layer": ["walls"]}, "no plan is given"),
        ({"plan": "a.dxf", "plan_unit": "mile"}, f"'mile': must be one of {', '.join(Unit)}"),
        ({"continue_": "plan.dxf"}, "plan.dxf: is a plan and no session"),
        ({"localize": "nowhere"}, "nowhere"),
    ],
)
def test_contradictions_are_one_line(arguments: dict[str, Any], problem: str) -> None:
    with pytest.raises(SlamError, match=problem) as raised:
        slam.run(FIRST, **arguments)
    assert "\n" not in str(raised.value)


def test_ranges_of_an_unknown_unit_are_named_with_the_recording(wclm: Any, tmp_path: Path) -> None:
    """Without a motion, the reader does not know how far a unit is."""
    standing = next(m.pose for m in Simulation("room", duration=1.0) if isinstance(m, Odometry))
    with McapWriter(tmp_path / "drive.mcap") as writer:
        for m in Simulation("room", duration=4.0, lidar=LIDAR_MODELS["short"]):
            if isinstance(m, Odometry):
                writer.write(replace(m, pose=standing))
            elif isinstance(m, Scan):
                writer.write(replace(m, ranges=1000.0 * m.ranges, range_max=40_000.0))
    with pytest.raises(SlamError, match=r"drive\.mcap: scan at .* nearly all ranges are beyond 100"):
        slam.run(tmp_path / "drive.mcap")
    wclm.refuses("run", "drive.mcap", "--out", "map", because=["drive.mcap: scan at ", "they must be in metres"])


def test_an_output_directory_is_no_recording(session: Path) -> None:
    with pytest.raises(MapError, match="contains the results of a run and no recording"):
        slam.run(session)


def test_only_a_map_that_is_extended_is_refined(session: Path) -> None:
    with pytest.raises(MapError, match="nothing to refine"):
        slam.run(LATER, refine=True, localize=session)
