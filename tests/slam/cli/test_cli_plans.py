"""Plans on the command line: options that fit together, errors, and what a run with a plan writes."""

import json
import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.simulation.world import load_world

from ..robot import WCLM

MEBIBYTE = 1 << 20


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
    result = wclm("run", "sim:room?duration=14&lidar=short", "--plan", str(plan), *start, "--out", "out", "--no-review")
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
    result = wclm("run", "sim:room?duration=3&lidar=short", "--plan", str(plan), "--out", "out", "--no-review")
    assert re.search(r"states no unit and is read in metres: 6(\.\d+)? m x 4(\.\d+)? m", result.output)


def test_options_that_do_not_fit_together_are_refused(wclm: Any, plan: Path) -> None:
    run = ("run", "sim:room", "--out", "out")
    assert wclm(*run, "--plan", str(plan), "--continue", "out").exit_code == 2
    assert wclm(*run, "--start", "0,0,0").exit_code == 2
    wclm.refuses(*run, "--continue", str(plan), because=["room.geojson", "no session to continue"])
    wclm.refuses(*run, "--plan", str(plan), "--plan-unit", "mm", because=["room.geojson", "--plan-unit"])
    wclm.refuses(*run, "--plan", str(plan), "--plan-layer", "A", because=["room.geojson", "DXF"])
    for option in (("--plan-unit", "mm"), ("--plan-layer", "A")):
        wclm.refuses(*run, *option, because=["--plan-unit / --plan-layer: no plan is given"])
        wclm.refuses("diff", "map", "map", *option, because=["--plan-unit / --plan-layer: no plan is given"])
    wclm.refuses(*run, "--localize", __file__, because=["test_cli_plans.py: is no plan", ".dxf, .geojson"])
    wclm.refuses(*run, "--plan", "nowhere.dxf", because=["nowhere.dxf: No such file"])
    assert not Path("out").exists()


def test_bad_plans_are_refused_in_one_line(wclm: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slam.mapping.plan_views.MAX_VIEWS", 2000)  # found to be exceeded in a tenth of the time
    lines = load_world("office").segments.reshape(-1, 2, 2)
    run = ("run", "sim:room?duration=3&lidar=short", "--out", "out", "--no-review", "--plan")
    for name, scale, problem in (
        ("millimetres", 1000.0, r"would be 2\.53e\+04 m x 1\.53e\+04 m; state the unit"),
        ("inches", 1.0 / 0.0254, r"more than \d+ views in 996\.1 m x 602\.4 m; state the unit"),
        ("kilometres", 0.001, "state the unit"),
        ("degrees", 1e-5, "state the unit of the drawing with --plan-unit; degrees of longitude and latitude are not"),
        ("empty", np.zeros(0), "has no straight line"),
    ):
        path = tmp_path / f"{name}.geojson"
        scaled = (scale * lines).tolist() if name != "empty" else []
        path.write_text(json.dumps({"type": "MultiLineString", "coordinates": scaled}))
        result = wclm(*run, str(path))
        assert result.exit_code == 2
        (error,) = [line for line in result.output.splitlines() if line != "wclm: reading the plan"]
        assert re.search(problem, error)
        assert path.name in error
    assert not Path("out").exists()


def test_a_plan_whose_lines_cross_each_other_is_left_out_if_it_is_of_another_building(wclm: Any) -> None:
    outline = np.random.default_rng(0).uniform(0.0, 20.0, (60, 2)).tolist()
    Path("star.json").write_text(json.dumps({"type": "Polygon", "coordinates": [[*outline, outline[0]]]}))
    run = ("run", "sim:room?duration=3&lidar=short", "--out", "out", "--no-review", "--plan-unit", "m")
    result = wclm(*run, "--plan", "star.json")
    assert result.exit_code == 0, result.output
    assert "never recognised in the plan" in result.output


def million_lines(suffix: str) -> Iterator[str]:
    """Yield the parts of a drawing of a million lines."""
    random = np.random.default_rng(0)
    begin = random.uniform(0.0, 300.0, (1_000_000, 2))
    lines = np.column_stack([begin, begin + random.uniform(0.1, 1.0, begin.shape)]).tolist()
    head, line, tail = {
        "svg": (
            '<svg xmlns="http://www.w3.org/2000/svg">',
            '<line x1="{:.3f}" y1="{:.3f}" x2="{:.3f}" y2="{:.3f}"/>\n',
            "</svg>",
        ),
        "geojson": (
            '{"type": "MultiLineString", "coordinates": [[[0, 0], [1, 1]]',
            ",[[{:.3f},{:.3f}],[{:.3f},{:.3f}]]",
            "]}",
        ),
        "dxf": (
            "0\nSECTION\n2\nENTITIES\n",
            "0\nLINE\n8\n0\n10\n{:.3f}\n20\n{:.3f}\n11\n{:.3f}\n21\n{:.3f}\n",
            "0\nENDSEC\n0\nEOF\n",
        ),
    }[suffix]
    yield head
    for numbers in lines:
        yield line.format(*numbers)
    yield tail


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["svg", "geojson", "dxf"])
def test_a_plan_of_a_million_lines_is_refused_in_time_and_memory(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"plan.{suffix}"
    with path.open("w") as file:
        file.writelines(million_lines(suffix))
    arguments = ["run", "sim:room", "--out", str(tmp_path / "out"), "--plan", str(path)]
    with (tmp_path / "errors").open("w") as errors:
        process = subprocess.Popen([*WCLM, *arguments], stderr=errors)
        _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 2
    first, last = (tmp_path / "errors").read_text().splitlines()
    assert first == "wclm: reading the plan"
    assert re.search(r"plan\.\w+: has 100000\d lines, more than 50000; export the walls alone", last)
    assert usage.ru_utime < 150.0  # 5 to 35 s on a current processor
    assert usage.ru_maxrss * 1024 < 2500 * MEBIBYTE
