"""Benchmark of whole runs, comparison over versions, and regression checks."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from slam.errors import MapError
from slam.evaluation.benchmarks import regression_checks
from slam.evaluation.benchmarks.regression_checks import Check
from slam.evaluation.benchmarks.released_versions import read_versions
from slam.evaluation.benchmarks.slam_runs import RECORDINGS, WORLDS, RunSpec, list_runs, run_once
from slam.visualisation.plots.version_history import plot_versions


@pytest.mark.slow
def test_a_run_is_scored_and_repeatable() -> None:
    spec = RunSpec("room", seed=2, seconds=8.0)
    first, second = run_once(spec), run_once(spec)
    assert first.scored_by == "true path"
    assert 0.0 < first.error < 0.02
    assert first.scans == 79
    assert first.walls >= 4
    assert first.memory > 10
    assert first.scan_ms > 0
    assert first.by_reference > 0
    timed = {"scan_ms": 0.0, "by_reference": 0.0, "memory": 0.0}
    assert replace(first, **timed) == replace(second, **timed)


def test_recordings_are_listed_if_complete(tmp_path: Path) -> None:
    assert [spec.name for spec in list_runs(None)] == list(WORLDS)
    assert [spec.name for spec in list_runs(tmp_path)] == list(WORLDS)
    name = RECORDINGS[1]
    (tmp_path / name).mkdir()
    (tmp_path / name / f"{name}.clf").write_text("")
    assert [spec.name for spec in list_runs(tmp_path)] == list(WORLDS)
    (tmp_path / name / f"{name}.relations").write_text("")
    assert list_runs(tmp_path) == [RunSpec(name, tmp_path), *(RunSpec(world) for world in WORLDS)]
    assert all(spec.folder is None and spec.seconds for spec in list_runs(tmp_path, quick=True))


@pytest.mark.slow
def test_the_command_writes_figures_and_a_plot(wclm: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slam.evaluation.benchmarks.slam_runs.QUICK_SECONDS", 5.0)
    before = {"name": "room", "error": 0.1, "by_reference": 90.0, "memory": 300.0}
    old = {"versions": {"wclm-slam": "0.0.9"}, "drives": [before]}
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "0.0.9.json").write_text(json.dumps(old))
    file, picture = tmp_path / "new" / "now.json", tmp_path / "versions.png"
    result = wclm(
        *("bench", "slam", "--quick", "--seed", "4", "--json", str(file)),
        *("--versions", str(tmp_path / "old"), "--plot", str(picture)),
    )
    assert result.exit_code == 0, result.output
    assert "processor" in result.output
    assert "seed 4" in result.output
    content = json.loads(file.read_text(encoding="utf-8"))
    assert {drive["name"] for drive in content["drives"]} == {"office", "room"}
    assert all(drive["seed"] == 4 for drive in content["drives"])
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_versions_are_sorted_by_number(tmp_path: Path) -> None:
    for version in ("0.10.0", "0.2.0", "0.9.1"):
        (tmp_path / f"{version}.json").write_text(json.dumps({"versions": {"wclm-slam": version}, "drives": []}))
    assert list(read_versions(tmp_path)) == ["0.2.0", "0.9.1", "0.10.0"]
    (tmp_path / "odd.json").write_text("[1]")
    with pytest.raises(MapError, match=r"odd\.json: not written by"):
        read_versions(tmp_path)


@pytest.mark.slow
def test_a_version_may_lack_a_run(tmp_path: Path) -> None:
    one = {"name": "a", "error": 1.0, "by_reference": 2.0, "memory": 3.0}
    plot_versions(tmp_path / "x.png", {"1": [one], "2": [one | {"name": "b"}]})
    assert (tmp_path / "x.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("times", "runs", "value"),
    [([11.0, 10.0] * 2, 4, 10.0), ([14.0] * 6 + [11.5], 7, 11.5), ([14.0, 15.0] * 8, 16, 14.0)],
    ids=["idle", "six runs slowed down", "slower program"],
)
def test_load_is_no_regression_and_a_slower_program_is(
    monkeypatch: pytest.MonkeyPatch, times: list[float], runs: int, value: float
) -> None:
    """Times of runs in units of the reference timed along with them; the limit is 12."""
    made = iter(times)
    monkeypatch.setattr(regression_checks, "run_once", lambda _: SimpleNamespace(by_reference=next(made)))
    assert regression_checks.time_by_reference(RunSpec("room"), 12.0) == value
    assert len(list(made)) == len(times) - runs


@pytest.mark.slow
def test_the_reference_is_timed_during_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """A processor that takes twice as long for everything gives the same ratio."""
    clock = iter(range(10**9))
    ratios = []
    for pace in (1.0, 2.0):
        monkeypatch.setattr("time.process_time", lambda pace=pace: pace * next(clock))
        ratios.append(run_once(RunSpec("room", seconds=4.0)).by_reference)
    assert ratios[0] == ratios[1] > 0.0


def test_a_regression_is_an_exit_status(wclm: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    good, slow = Check("recall", 0.99, 0.9, floor=True), Check("time", 2.0, 1.5)
    monkeypatch.setattr(regression_checks, "run_checks", lambda: iter([good]))
    assert wclm("bench", "gate").exit_code == 0
    monkeypatch.setattr(regression_checks, "run_checks", lambda: iter([good, slow]))
    result = wclm("bench", "gate")
    assert result.exit_code == 1
    assert "REGRESSION" in result.output
    assert not Check("recall", float("nan"), 0.9, floor=True).passed
    assert not Check("error", float("nan"), 0.9).passed
