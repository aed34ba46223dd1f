"""A place like that of a reader of the documentation: recordings and results under the names that the pages use."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from drivers import se2
from drivers.messages import GroundTruth, Odometry, Scan, Source
from drivers.simulation import simulator
from slam.cli.app import app
from slam.io.tum import Trajectory, read_tum, write_tum

SECONDS = 12.0
"""Of any simulated drive: more than a hundred scans."""
FEW_BEAMS = simulator.Lidar(beams=240)
WORLD = """\
title = "a room to calibrate in"
speed = 0.9
path = [[1, 1], [2, 2.4], [3, 1.2], [4, 2.6], [5, 1.2], [4, 3], [2, 3], [1, 1]]

[[walls]]
from = [0, 0]
to = [6, 0]

[[walls]]
from = [6, 0]
to = [6, 4]

[[walls]]
from = [6, 4]
to = [0, 4]

[[walls]]
from = [0, 4]
to = [0, 0]
"""
GRAPH = """\
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 0
VERTEX_SE2 2 2.1 0 0
EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400
EDGE_SE2 1 2 1 0 0 100 0 0 100 0 400
EDGE_SE2 0 2 2 0 0 100 0 0 100 0 400
"""


def wclm(*words: str) -> Result:
    """Run a command in this process."""
    return CliRunner().invoke(app, list(words))


@contextlib.contextmanager
def simulations_of(seconds: float) -> Iterator[None]:
    """Simulations are short, and their lidar is quick to work on."""
    whole = simulator.Simulation

    def short(
        world: Any = "office",
        seed: int = 0,
        duration: Any = None,
        lidar: Any = None,
        drive: Any = None,
        *rest: Any,
        **more: Any,
    ) -> Any:
        return whole(world, seed, min(duration or seconds, seconds), FEW_BEAMS, drive, *rest, **more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulator, "Simulation", short)
        patch.setenv("COLUMNS", "200")
        patch.delenv("DISPLAY", raising=False)
        patch.delenv("WAYLAND_DISPLAY", raising=False)
        yield


@pytest.fixture(scope="session")
def given(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the pages take for granted: a recording, what a run made of it, the truth, a benchmark, a pose graph."""
    place = tmp_path_factory.mktemp("given")
    with simulations_of(SECONDS):
        fill(place)
    return place


def fill(place: Path) -> None:
    """Write everything that is given into a directory; the recording is named as `drive.mcap` and as `intel.clf`."""
    world = place / "room.toml"
    world.write_text(WORLD, encoding="ascii")
    for words in (f"simulate {world} {place}/drive.mcap", f"run {place}/drive.mcap --out {place}/map --no-review"):
        result = wclm(*words.split())
        assert result.exit_code == 0, result.output
    source = simulator.Simulation(world)
    _write_carmen(place / "intel.clf", source)
    truth = [message for message in source if isinstance(message, GroundTruth)]
    stamps, poses = np.array([m.stamp for m in truth]), np.array([m.pose for m in truth])
    write_tum(place / "truth.tum", Trajectory(stamps, poses))
    motion = se2.between(poses[0], poses[-1])
    (place / "intel.relations").write_text(
        f"{stamps[0]:.6f} {stamps[-1]:.6f} {motion[0]} {motion[1]} 0 0 0 {motion[2]}\n", encoding="ascii"
    )
    for folder in ("monday", "tuesday"):
        (place / folder).mkdir()
        shutil.copy(place / "drive.mcap", place / folder / f"{folder}.mcap")
    for folder in ("intel", "out"):
        shutil.copytree(place / "map", place / folder)
        assert len(read_tum(place / folder / "trajectory.tum")) > 1
    (place / "graph.g2o").write_text(GRAPH, encoding="ascii")


def _write_carmen(path: Path, source: Source) -> None:
    """A CARMEN log of a lidar that sits in the middle and looks half around, as the benchmark's do."""
    lines, pose = [], np.zeros(3)
    for message in source:
        if isinstance(message, Odometry):
            pose = message.pose
            x, y, heading = pose
            lines.append(f"ODOM {x:.6f} {y:.6f} {heading:.6f} 0 0 0 {message.stamp:.6f} host {message.stamp:.6f}")
        elif isinstance(message, Scan):
            ahead = message.ranges[(message.angles >= -np.pi / 2) & (message.angles < np.pi / 2)]
            ranges = " ".join(f"{r:.3f}" for r in np.nan_to_num(ahead, nan=81.83))
            place = f"{pose[0]:.6f} {pose[1]:.6f} {pose[2]:.6f}"
            lines.append(f"FLASER {len(ahead)} {ranges} {place} {place} {message.stamp:.6f} host {message.stamp:.6f}")
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


class Reader:
    """Types a page's commands one after the other, in a directory where what the page takes for granted is there."""

    def __init__(self, given: Path) -> None:
        self._given = {path.name for path in given.iterdir()}

    def types(self, words: list[str]) -> None:
        """Run a command; what it writes may replace what was given, but nothing that the page has made itself."""
        outputs = [after for word, after in pairwise(words) if word == "--out"]
        outputs += words[3:4] if words[1] == "simulate" else []
        for path in map(Path, self._given.intersection(outputs)):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        self._given.difference_update(outputs)
        result = wclm(*(path for word in words[1:] for path in _expanded(word)))
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        assert result.exit_code == 0, f"{' '.join(words)}: {result.output}"


def _expanded(word: str) -> list[str]:
    """What a shell makes of a word."""
    return [str(path) for path in sorted(Path().glob(word))] if "*" in word else [word]


@pytest.fixture
def reader(given: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Reader:
    shutil.copytree(given, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return Reader(given)
