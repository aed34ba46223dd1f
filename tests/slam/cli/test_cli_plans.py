"""Plans on the command line: options that fit together, errors, and what a run with a plan writes."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from drivers.simulation.world import load_world


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    """Return the plan of the room, in which its box is missing."""
    lines = load_world("room").segments.reshape(-1, 2, 2)
    path = tmp_path / "room.geojson"
    outside = [line.tolist() for line in lines if not ((line > 1.0) & (line < 3.9)).all()]
    assert 0 < len(outside) < len(lines)
    path.write_text(json.dumps({"type": "MultiLineString", "coordinates": outside}))
    return path


def test_a_run_with_a_plan_states_the_differences(wclm: Any, plan: Path) -> None:
    start = ("--start", "1,1,0", "--plan-unit", "m")
    result = wclm("run", "sim:room?duration=14", "--plan", str(plan), *start, "--out", "out", "--no-review")
    assert result.exit_code == 0, result.output
    found = json.loads(Path("out/summary.json").read_text())["plan"]
    assert (found["file"], found["recognised"]) == ("room.geojson", True)
    assert found["supported"] >= 3
    assert found["differences"]
    assert all(line.startswith("new: ") for line in found["differences"])
    assert found["differences"][0].split(", seen")[0] in result.output
    changes = {one["properties"]["change"] for one in json.loads(Path("out/plan.geojson").read_text())["features"]}
    assert "new" in changes
    assert 'class="new"' in Path("out/plan.svg").read_text()


def test_the_assumed_unit_and_the_size_are_printed(wclm: Any, plan: Path) -> None:
    result = wclm("run", "sim:room?duration=3", "--plan", str(plan), "--out", "out", "--no-review")
    assert re.search(r"states no unit and is read in metres: 6(\.\d+)? m x 4(\.\d+)? m", result.output)


def test_options_that_do_not_fit_together_are_refused(wclm: Any, plan: Path) -> None:
    run = ("run", "sim:room", "--out", "out")
    assert wclm(*run, "--plan", str(plan), "--continue", "out").exit_code == 2
    assert wclm(*run, "--start", "0,0,0").exit_code == 2
    wclm.refuses(*run, "--continue", str(plan), because=["room.geojson", "no session to continue"])
    wclm.refuses(*run, "--plan", str(plan), "--plan-unit", "mm", because=["room.geojson", "--plan-unit"])
    wclm.refuses(*run, "--plan", str(plan), "--plan-layer", "A", because=["room.geojson", "DXF"])
    wclm.refuses(*run, "--plan", "nowhere.dxf", because=["nowhere.dxf: No such file"])
    assert not Path("out").exists()
