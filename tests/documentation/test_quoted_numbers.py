"""Numbers that pages quote agree with each other, and with what the commands print."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from ..recordings import recording_file
from .blocks import ROOT
from .conftest import wclm

README, BENCHMARKS, COMPARISON = "README.md", "docs/benchmarks.md", "docs/comparison.md"


def text_of(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def rows(page: str, first: str) -> list[list[str]]:
    """Return the cells of the rows of tables whose first cell begins with a text."""
    cells = [[cell.strip(" *") for cell in line.split("|")[1:-1]] for line in text_of(page).splitlines() if "|" in line]
    return [row for row in cells if row and row[0].startswith(first)]


def benchmark(drive: str, column: int) -> list[float]:
    """Return the values of a cell of the table of the robustness benchmark: estimate, and odometry if it is there."""
    (row,) = [row for row in rows(BENCHMARKS, drive) if len(row) == 12 and row[0] == drive]
    return [float(value) for value in row[column].replace("*", "").split(" / ")]


def test_time_and_size_of_the_first_recording_are_the_same_everywhere() -> None:
    (row,) = rows(README, "Intel Research Lab")
    seconds, size = row[5].split()[0], row[7].split(", ")[-1]
    assert f"mapped in {seconds} seconds" in text_of(README)
    assert f"The map above has {size}," in text_of(README)
    assert f"mapped in {seconds} seconds" in text_of("docs/index.md")
    assert f"takes {seconds} s on two cores of a virtual machine, and its map has {size}" in text_of("docs/faq.md")


@pytest.mark.parametrize("name", ["fhw", "edmonton", "wean-2", "mines-1", "slambot", "corridor", "ual-2014"])
def test_errors_on_other_recordings_are_those_of_the_benchmark(name: str) -> None:
    folder = {"wean-2": "wean/wean-2", "mines-1": "mines/mines-1"}.get(name, name)
    (quoted,) = rows(README, name)
    assert [float(quoted[3]), float(quoted[4])] == benchmark(folder, 3)
    assert float(quoted[2].split()[0]) == benchmark(folder, 2)[0]


def test_the_comparison_quotes_the_benchmark() -> None:
    relations, halls = rows(COMPARISON, "wclm-slam")
    assert [float(value) for value in relations[1:]] == [benchmark(name, 3)[0] for name in ("intel", "fr079", "csail")]
    assert [float(value) for value in halls[1:]] == [
        round(benchmark(name, 3)[0] + 1e-9, 2) for name in ("fhw", "edmonton")
    ]
    for name, folder in (("wean-2", "wean/wean-2"), ("slambot", "slambot"), ("lego", "lego"), ("ual-2014", "ual-2014")):
        (quoted,) = rows(COMPARISON, name)
        assert float(quoted[1]) == benchmark(folder, 5)[0]


@pytest.mark.slow
def test_the_demo_shows_the_drift_that_getting_started_states(tmp_path: Path) -> None:
    from slam.visualisation.rerun_log.log_files import find_log
    from slam.visualisation.rerun_log.rrd_reader import chunks_of
    from slam.visualisation.rerun_log.rrd_reader import rows as log_rows

    out = tmp_path / "demo"
    assert wclm("demo", "--no-view", "--out", str(out)).exit_code == 0
    logged = log_rows(list(chunks_of(find_log(out).files)), "/log")
    texts = " ".join(row.values["TextLog:text"][0] for row in logged)
    (robot,) = re.findall(r"the robot moved by ([\d.]+) m", texts)
    (path,) = re.findall(r"the path moved by up to ([\d.]+) m", texts)
    stated = f"which moves the robot by {float(robot):.1f} m, and parts of the path by {float(path):.1f} m"
    assert stated in text_of("docs/getting-started.md")


@pytest.mark.slow
def test_results_on_a_public_recording_are_those_of_the_readme(tmp_path: Path) -> None:
    log, relations, out = recording_file("csail"), recording_file("csail", "relations"), tmp_path / "map"
    assert wclm("run", str(log), "--out", str(out), "--no-review").exit_code == 0
    scored = wclm("eval", str(out / "trajectory.tum"), "--relations", str(relations)).stdout.split()
    (row,) = rows(README, "MIT CSAIL")
    assert float(scored[scored.index("translation") + 1]) == pytest.approx(float(row[2].split()[0]), abs=0.002)
    summary = json.loads((out / "summary.json").read_text())
    walls, corners, size = (int(part.split()[0]) for part in row[7].split(", "))
    assert summary["walls"] == pytest.approx(walls, rel=0.05)
    assert summary["corners"] == pytest.approx(corners, rel=0.1)
    assert (out / "map.json").stat().st_size / 1000 == pytest.approx(size, rel=0.05)
