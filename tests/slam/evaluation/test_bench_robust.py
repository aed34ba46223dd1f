"""Recordings and worlds of the robustness benchmark, and their comparison with raw odometry."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import drivers
from drivers import se2
from drivers.messages import Message, Odometry, Scan, Source
from drivers.recordings.mcap import McapWriter
from drivers.simulation import LidarModel, Simulation
from slam import Slam
from slam.cli.commands.bench.timing import resolve_timing
from slam.config import Config, LidarConfig
from slam.errors import MapError
from slam.evaluation.benchmarks import robust
from slam.evaluation.benchmarks.robust import Job, run_job, run_jobs
from slam.evaluation.benchmarks.robust_drives import VARIANTS, WORLDS, LaterMode, SimulatedWorld, find_recordings
from slam.evaluation.benchmarks.robust_scores import (
    PathScore,
    RobustResult,
    ScoredRun,
    reference_errors,
    trajectory_errors,
    trajectory_errors_in_map,
)
from slam.evaluation.benchmarks.robust_table import TABLE_HEAD, table_row
from slam.evaluation.benchmarks.scenarios import later_drives
from slam.evaluation.benchmarks.scenarios.later_drives import LaterDrive
from slam.io.tum import Trajectory, write_tum

LIDAR = LidarModel(beams=180, rate=6.0)
NO_ERRORS = (math.nan, math.nan)


def defaults(_: Source) -> Config:
    return Config()


def record(file: Path, messages: Iterable[Message]) -> None:
    file.parent.mkdir(exist_ok=True)
    with McapWriter(file) as writer:
        for message in messages:
            writer.write(message)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory with a short recording and its true path, and a broken recording."""
    folder = tmp_path_factory.mktemp("recordings")
    drive = Simulation("room", seed=3, duration=7.0, lidar=LIDAR)
    record(folder / "room" / "room.mcap", drive)
    stamps = np.arange(0.0, 7.0, 0.1)
    write_tum(folder / "room" / "room.truth.tum", Trajectory(stamps, drive.trajectory.poses_at(stamps)))
    (folder / "other").mkdir()
    (folder / "other" / "broken.clf").write_text("nothing\n")
    return folder


def test_recordings_are_found_with_their_references(tmp_path: Path) -> None:
    names = ["intel/intel.clf.bz2", "mines/mines-1.clf", "mines/mines-3.clf", "lego/lego.clf", "dog/dog.bag", "cat.db3"]
    references = ["intel/intel.relations", "intel/intel.gmapping.tum", "mines/mines-1.lama.tum", "lego/lego.camera.tum"]
    for name in [
        *names,
        *references,
        "mines/mines-1.gmapping.tum",
        "tb4/bag/metadata.yaml",
        "tb4/bag/a.mcap",
        "tb4/bag/b.db3",
        "README",
    ]:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    found = {drive.name: drive.reference for drive in find_recordings(tmp_path)}
    assert list(found) == ["cat", "dog", "intel", "lego", "mines/mines-1", "mines/mines-3", "tb4/bag"]
    assert [drive.origin for drive in find_recordings(tmp_path)] == ["", "", "relations", "camera", "gmapping", "", ""]
    assert [None if path is None else path.name for path in found.values()] == [
        None,
        None,
        "intel.relations",
        "lego.camera.tum",
        "mines-1.gmapping.tum",
        None,
        None,
    ]
    (tmp_path / "empty").mkdir()
    with pytest.raises(MapError, match="contains no recordings"):
        find_recordings(tmp_path / "empty")


def test_paths_are_compared_with_relations_or_a_trajectory(tmp_path: Path) -> None:
    stamps = np.arange(10.0)
    path = Trajectory(stamps, np.column_stack([stamps, 0.1 * stamps**2, np.zeros(10)]))
    (tmp_path / "a.relations").write_text("2.0 5.0 3.0 2.0 0 0 0 0\n0.0 1.0 1.0 0.1 0 0 0 0\n")
    assert reference_errors(path, tmp_path / "a.relations") == (pytest.approx(0.05), pytest.approx(0.1))
    write_tum(tmp_path / "a.lama.tum", Trajectory(stamps[2:8] + 0.5, path.at(stamps[2:8] + 0.5).poses))
    assert reference_errors(path, tmp_path / "a.lama.tum") == (pytest.approx(0.0, abs=1e-5), pytest.approx(0, abs=1e-5))


def test_a_recording_is_scored_against_its_reference_and_odometry(folder: Path) -> None:
    broken, good = find_recordings(folder)
    result = run_job(Job(good), defaults)
    assert (result.name, result.reference, result.failed) == ("room", "truth", "")
    assert 0.0 < 2.0 * result.slam.error < result.odometry.error
    assert result.slam.entropy < result.odometry.entropy
    assert result.placed > 0.9
    assert (result.lost, result.worse, result.suspects) == (0.0, (), ())
    assert result.cpu > 0.0
    failed = run_job(Job(broken), defaults)
    assert failed.name == "other/broken"
    assert "broken.clf" in failed.failed
    assert "internal error" not in failed.failed


def test_a_recording_without_odometry_is_mapped_as_by_wclm_run(folder: Path, tmp_path: Path) -> None:
    good = find_recordings(folder)[1]
    record(
        tmp_path / "room.mcap", (message for message in drivers.open(good.path) if not isinstance(message, Odometry))
    )
    result = run_job(Job(replace(good, path=tmp_path / "room.mcap")), resolve_timing)
    assert result.failed == ""
    assert result.slam.error < 0.1
    assert result.placed > 0.9
    assert math.isnan(result.odometry.error)
    assert math.isnan(result.odometry.entropy)


def test_scans_are_drawn_from_the_mount_of_the_settings() -> None:
    drive = list(Simulation("room", seed=3, duration=7.0, lidar=LIDAR, mount=(0.2, 0.0, 2.0)))
    stated = ScoredRun(Slam(), drive).result("", "", [NO_ERRORS] * 2)
    unstated = [replace(message, mount=None) if isinstance(message, Scan) else message for message in drive]
    slam = Slam(Config(lidar=LidarConfig(mount=(0.2, 0.0, 2.0))))
    assert ScoredRun(slam, unstated).result("", "", [NO_ERRORS] * 2).slam.entropy == stated.slam.entropy


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS)
def test_variants_of_a_recording_are_scored_against_its_reference(folder: Path, variant: str) -> None:
    _, good = find_recordings(folder)
    result = run_job(Job(good, seed=1, variant=variant), defaults)
    assert (result.reference, result.failed) == ("truth", "")
    assert result.slam.error < result.odometry.error
    assert result.slam.error < 0.05


@pytest.mark.slow
def test_a_drawn_drive_is_the_same_for_the_same_seed() -> None:
    drives = [WORLDS["strangers"].simulation(seed) for seed in (0, 0, 1)]
    assert drives[0].lidar == drives[1].lidar != drives[2].lidar
    assert drives[0].wheels == drives[1].wheels != drives[2].wheels
    assert np.array_equal(drives[0].mount, drives[1].mount)
    assert not np.array_equal(drives[0].mount, drives[2].mount)


@pytest.mark.slow
def test_a_world_is_scored_by_its_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    short = replace(WORLDS["crowd"], duration=6.0)
    monkeypatch.setitem(robust.WORLDS, "crowd", short)
    (result,) = run_jobs([Job(None, "crowd", 4)], defaults)
    assert (result.name, result.reference, result.failed) == ("crowd 4", "truth", "")
    assert result.slam.error < 0.02


@pytest.mark.parametrize("name", ["known-map", "refurnished-map"])
def test_furniture_is_another_one_on_another_day(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    drives: list[bool] = []

    def later(_: Simulation, *, refurnished: bool) -> LaterDrive:
        drives.append(refurnished)
        raise MapError("not driven")

    monkeypatch.setattr(robust, "later_drive", later)
    monkeypatch.setattr(robust, "ScoredRun", lambda *_: SimpleNamespace(path=(np.zeros(1), np.zeros((1, 3)))))
    assert run_job(Job(None, name, 6007), defaults).failed == "not driven"
    assert drives == [name == "refurnished-map"]


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["localize", "continue"])
def test_a_drive_on_another_day_is_scored_in_the_map(monkeypatch: pytest.MonkeyPatch, mode: LaterMode) -> None:
    monkeypatch.setattr(later_drives, "LATER_SECONDS", 10.0)
    world = SimulatedWorld("", lambda seed: Simulation("office", seed, 14.0, LIDAR), later=mode)
    monkeypatch.setitem(robust.WORLDS, "known-map", world)
    result = run_job(Job(None, "known-map", 3), defaults)
    assert (result.name, result.reference, result.failed) == ("known-map 3", "truth", "")
    assert 0.0 < result.slam.error < 0.05
    assert 0.9 < result.placed <= 1.0
    assert 50 < result.scans < 61


def test_a_displacement_in_the_map_is_an_error() -> None:
    """Both drives start in the origin of a frame that is turned against the map; the later one is 0.3 m off."""
    stamps = np.arange(10.0)
    true = np.column_stack([stamps, 0.1 * stamps**2, np.zeros(10)])
    mapped = se2.compose(np.array([1.0, 2.0, 0.5]), true)
    off = se2.compose(np.array([1.0, 2.0, 0.5]), true + np.array([0.0, 0.3, 0.0]))
    paths = Trajectory(stamps, off), Trajectory(stamps, true), Trajectory(stamps, mapped), Trajectory(stamps, true)
    assert trajectory_errors_in_map(*paths) == (pytest.approx(0.3), pytest.approx(0.3))
    assert trajectory_errors(*paths[:2]) == (pytest.approx(0.0, abs=1e-6), pytest.approx(0.0, abs=1e-6))


def test_worse_scores_than_odometrys_are_bold() -> None:
    good = RobustResult("a", "lama", slam=PathScore(0.1, 0.3, 0.2, 0.1), odometry=PathScore(1.0, 2.0, 0.3, 0.3))
    bad = replace(good, name="b", slam=PathScore(1.2, 2.0, 0.301, 0.4))
    none = replace(
        good, name="c", slam=PathScore(np.nan, np.nan, 0.2, 0.1), odometry=PathScore(np.nan, np.nan, 0.3, 0.3)
    )
    failed = RobustResult("d", failed="no laser scan")
    assert [result.worse for result in (good, bad, none, failed)] == [(), ("error", "conflict"), (), ()]
    table = [*TABLE_HEAD, *map(table_row, (good, bad, none, failed))]
    assert len({line.count("|") for line in table}) == 1
    assert "| **1.200** / 1.000 |" in table[3]
    assert "| 0.301 / 0.300 |" in table[3]
    assert "no map: no laser scan" in table[5]


def test_the_command_prints_a_table_or_one_line_of_json(wclm: Any, folder: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("slam.warmup.warm_up", lambda: None)
    monkeypatch.setattr(robust, "run_job", lambda job, prepare: RobustResult(job.name, failed="skipped"))
    options = ("bench", "robust", str(folder), "--processes", "1", "--first-seed", "7", "--seeds", "1")
    content = wclm(*options, "--json").stdout
    assert len(content.splitlines()) == 1
    names = [drive["name"] for drive in json.loads(content)["drives"]]
    assert names == ["other/broken", "room", *(f"{world} 7" for world in WORLDS)]
    result = wclm(*options, "--condition", "room", "--condition", "crowd")
    assert [line.split(" ")[1] for line in result.stdout.splitlines()[5:]] == ["room", "crowd"]
    wclm.refuses(*options, "--condition", "moon", because=["moon", "no such condition", "room"])
    wclm.refuses(*options, "--variant", "moon", because=["--variant moon", "no such variant", "backwards"])
    content = wclm(*options, "--json", "--condition", "room", "--variant", "drift", "--variant", "backwards").stdout
    assert [drive["name"] for drive in json.loads(content)["drives"]] == ["room drift 7", "room backwards"]
    wclm.refuses("bench", "robust", str(folder / "gone"), because=["gone: no such directory"])
    text = " ".join(wclm("bench", "robust", "--help").output.replace("│", " ").split())
    assert all(name in text for name in WORLDS)
