"""Directory of a reader of the documentation: recordings and results under the names that the pages use."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Collection, Hashable, Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from drivers import se2, simulation
from drivers.messages import GroundTruth, Odometry, Scan, Source
from drivers.timing import beam_order, delay
from drivers.timing.turns import Turns
from slam.cli.app import app
from slam.io.tum import Trajectory, read_tum, write_tum

from ..replacements import replaced

DURATION = 8.0
"""Duration of simulated drives, seconds; they turn enough to calibrate from."""
FEW_BEAMS = simulation.LidarModel(beams=160, rate=5.0)
"""Lidar of simulated drives: the robot moves by 0.2 m in a revolution."""
WORLD = """\
title = "a room to calibrate in"
speed = 1.2
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
HALL = """\
title = "a furnished hall, which is not equal to itself turned by 180 degrees: drives can be recognised in it"
speed = 0.9
path = [[1.5, 1.5], [3, 3.6], [4.5, 1.8], [6, 3.9], [7.5, 1.8], [6, 4.5], [3, 4.5], [1.5, 1.5]]
""" + "".join(
    f"\n[[walls]]\nfrom = {list(start)}\nto = {list(end)}\n"
    for start, end in (
        ((0, 0), (9, 0)), ((9, 0), (9, 6)), ((9, 6), (0, 6)), ((0, 6), (0, 0)),
        ((8.1, 6), (8.1, 4.3)), ((0, 1.4), (0.9, 0.4)), ((0, 3.3), (1.1, 3.3)),
        ((4.3, 6), (4.3, 5.3)), ((5.1, 0), (5.8, 0.9)), ((9, 2.9), (8.3, 3.5)),
    )
)  # fmt: skip
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
def simulations_of(seconds: float, scanner: simulation.LidarModel = FEW_BEAMS) -> Iterator[None]:
    """Limit the duration of simulations, and let all have the same lidar."""
    whole = simulation.Simulation

    def short(
        world: Any = "office",
        seed: int = 0,
        duration: Any = None,
        lidar: Any = None,
        wheels: Any = None,
        *rest: Any,
        **more: Any,
    ) -> Any:
        return whole(world, seed, min(duration or seconds, seconds), scanner, wheels, *rest, **more)

    with pytest.MonkeyPatch.context() as patch, replaced(simulation, "Simulation", short):
        patch.setenv("COLUMNS", "200")
        patch.delenv("DISPLAY", raising=False)
        patch.delenv("WAYLAND_DISPLAY", raising=False)
        yield


@pytest.fixture(scope="module", autouse=True)
def timing_is_estimated_once() -> Iterator[None]:
    """Estimate the timing of a recording once: the recordings of the pages are copies of a few, under several names."""
    with contextlib.ExitStack() as stack:
        for module, function in ((beam_order, "decide_beam_order"), (delay, "estimate_delay")):
            stack.enter_context(replaced(module, function, _cached(getattr(module, function))))
        yield


@cache
def _cached(estimate: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of turns that computes its result once in all modules for turns with the same odometry."""
    found: dict[tuple[Any, ...], Any] = {}

    def cached(turns: Turns, *others: Hashable) -> Any:
        key = (turns.odometry.tobytes(), *others)
        if key not in found:
            found[key] = estimate(turns, *others)
        return found[key]

    return cached


@pytest.fixture(scope="session")
def given(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files that the pages presuppose: recording, output directory, ground truth, relations, pose graph."""
    directory = tmp_path_factory.mktemp("given")
    with simulations_of(DURATION):
        fill(directory)
    return directory


def fill(directory: Path, room: str = WORLD) -> None:
    """Write the presupposed files; the recording, a drive through a `room`, is both `drive.mcap` and `intel.clf`."""
    world = directory / "room.toml"
    world.write_text(room, encoding="ascii")
    for words in (
        f"simulate {world} {directory}/drive.mcap",
        f"run {directory}/drive.mcap --out {directory}/map --no-review",
    ):
        result = wclm(*words.split())
        assert result.exit_code == 0, result.output
    source = simulation.Simulation(world)
    _write_carmen(directory / "intel.clf", source)
    truth = [message for message in source if isinstance(message, GroundTruth)]
    stamps, poses = np.array([m.stamp for m in truth]), np.array([m.pose for m in truth])
    write_tum(directory / "truth.tum", Trajectory(stamps, poses))
    motion = se2.between(poses[0], poses[-1])
    (directory / "intel.relations").write_text(
        f"{stamps[0]:.6f} {stamps[-1]:.6f} {motion[0]} {motion[1]} 0 0 0 {motion[2]}\n", encoding="ascii"
    )
    for folder in ("monday", "tuesday"):
        (directory / folder).mkdir()
        shutil.copy(directory / "drive.mcap", directory / folder / f"{folder}.mcap")
    for folder in ("intel", "out"):
        shutil.copytree(directory / "map", directory / folder)
        assert len(read_tum(directory / folder / "trajectory.tum")) > 1
    (directory / "graph.g2o").write_text(GRAPH, encoding="ascii")


def _write_carmen(path: Path, source: Source) -> None:
    """Write a CARMEN log of a centred lidar with a field of view of 180 degrees, as in the benchmark."""
    lines, pose = [], np.zeros(3)
    for message in source:
        if isinstance(message, Odometry):
            pose = message.pose
            x, y, heading = pose
            lines.append(f"ODOM {x:.6f} {y:.6f} {heading:.6f} 0 0 0 {message.stamp:.6f} host {message.stamp:.6f}")
        elif isinstance(message, Scan):
            ahead = message.ranges[(message.angles >= -np.pi / 2) & (message.angles < np.pi / 2)]
            ranges = " ".join(f"{r:.3f}" for r in np.nan_to_num(ahead, nan=81.83))
            position = f"{pose[0]:.6f} {pose[1]:.6f} {pose[2]:.6f}"
            lines.append(
                f"FLASER {len(ahead)} {ranges} {position} {position} {message.stamp:.6f} host {message.stamp:.6f}"
            )
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


class Reader:
    """Runs the commands of a page one after the other in a directory with the presupposed files."""

    def __init__(self, given: Path) -> None:
        self._given = {path.name for path in given.iterdir()}

    def run(self, words: list[str], statuses: Collection[int] = (0,)) -> None:
        """Run a command; it may replace presupposed files, but no results of earlier commands.

        statuses  that it may end with
        """
        outputs = [after for word, after in pairwise(words) if word == "--out"]
        outputs += words[3:4] if words[1] == "simulate" else []
        for path in map(Path, self._given.intersection(outputs)):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        self._given.difference_update(outputs)
        result = wclm(*(path for word in words[1:] for path in _expanded(word)))
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        assert result.exit_code in statuses, f"{' '.join(words)}: {result.output}"


def _expanded(word: str) -> list[str]:
    """Return a word with wildcards expanded."""
    return [str(path) for path in sorted(Path().glob(word))] if "*" in word else [word]


@pytest.fixture
def reader(given: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Reader:
    shutil.copytree(given, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return Reader(given)
