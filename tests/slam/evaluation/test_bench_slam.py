"""Whole drives measured, compared over versions, and held to what they came to before."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from slam.errors import MapError
from slam.evaluation.benchmarks import gate
from slam.evaluation.benchmarks.drives import RECORDINGS, WORLDS, Case, cases, drive
from slam.evaluation.benchmarks.gate import Check
from slam.evaluation.benchmarks.versions import read_versions
from slam.visualisation.plots.versions import plot_versions


def test_a_drive_is_judged_and_the_same_each_time() -> None:
    case = Case("room", seed=2, seconds=8.0)
    first, second = drive(case), drive(case)
    assert first.judge == "true path"
    assert 0.0 < first.error < 0.02
    assert first.scans == 79
    assert first.walls >= 4
    assert first.memory > 10
    assert first.scan_ms > 0
    assert first.by_reference > 0
    clocked = {"scan_ms": 0.0, "by_reference": 0.0, "memory": 0.0}
    assert replace(first, **clocked) == replace(second, **clocked)


def test_recordings_are_taken_where_they_are(tmp_path: Path) -> None:
    assert [case.name for case in cases(None)] == list(WORLDS)
    assert [case.name for case in cases(tmp_path)] == list(WORLDS)
    name = RECORDINGS[1]
    (tmp_path / name).mkdir()
    (tmp_path / name / f"{name}.clf").write_text("")
    assert [case.name for case in cases(tmp_path)] == list(WORLDS)
    (tmp_path / name / f"{name}.relations").write_text("")
    assert cases(tmp_path) == [Case(name, tmp_path), *(Case(world) for world in WORLDS)]
    assert all(case.folder is None and case.seconds for case in cases(tmp_path, quick=True))


def test_the_command_writes_figures_and_a_picture(wclm: Any, tmp_path: Path) -> None:
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


def test_versions_are_in_their_order(tmp_path: Path) -> None:
    for version in ("0.10.0", "0.2.0", "0.9.1"):
        (tmp_path / f"{version}.json").write_text(json.dumps({"versions": {"wclm-slam": version}, "drives": []}))
    assert list(read_versions(tmp_path)) == ["0.2.0", "0.9.1", "0.10.0"]
    (tmp_path / "odd.json").write_text("[1]")
    with pytest.raises(MapError, match=r"odd\.json: is not what"):
        read_versions(tmp_path)


def test_a_version_may_lack_a_drive(tmp_path: Path) -> None:
    one = {"name": "a", "error": 1.0, "by_reference": 2.0, "memory": 3.0}
    plot_versions(tmp_path / "x.png", {"1": [one], "2": [one | {"name": "b"}]})
    assert (tmp_path / "x.png").read_bytes().startswith(b"\x89PNG")


def test_what_fell_back_fails(wclm: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    good, slow = Check("recall", 0.99, 0.9, floor=True), Check("time", 2.0, 1.5)
    monkeypatch.setattr(gate, "checks", lambda: iter([good]))
    assert wclm("bench", "gate").exit_code == 0
    monkeypatch.setattr(gate, "checks", lambda: iter([good, slow]))
    result = wclm("bench", "gate")
    assert result.exit_code == 1
    assert "FELL BACK" in result.output
    assert not Check("recall", float("nan"), 0.9, floor=True).passed
    assert not Check("error", float("nan"), 0.9).passed
