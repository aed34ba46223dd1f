"""Fixtures of several tests: a small map, a replacement of the pipeline, commands, and a review log."""

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from ruamel.yaml import YAML
from typer.testing import CliRunner, Result

from drivers.messages import Message, Odometry, Scan
from features import LearnedNoise
from slam.cli.app import app
from slam.config import Config
from slam.estimation.slam_state import SlamState
from slam.events import Event, Finished, Notice
from slam.io.sessions import StoredSession
from slam.mapping.map_features import Keyframes, MapCorners, MapWalls
from slam.odometry.history import OdometryHistory
from slam.visualisation.rerun_log import ReviewLog

from ..replacements import replaced
from .closure_log import with_closure, write
from .corridor import Corridor


@pytest.fixture
def finished() -> Finished:
    """Result of a run in a room of 6 m by 4 m."""
    frames = np.array([[3, 0, 0], [6, 2, np.pi / 2], [3, 4, np.pi], [0, 2, -np.pi / 2]], float)
    half = np.array([3.0, 2.0, 3.0, 2.0])
    lines = MapWalls(
        identity=np.array([0, 1, 3, 7]),
        frame=frames,
        low=-half,
        high=half,
        observations=np.array([5, 4, 3, 2]),
        covariance=np.stack([*np.tile(np.diag([1e-5, 1e-7]), (3, 1, 1)), np.full((2, 2), np.nan)]),
        pieces=(*(np.array([[-h, h]]) for h in half[:3]), np.array([[-2.0, -0.5], [0.4, 2.0]])),
    )
    corners = MapCorners(
        identity=np.array([0, 1]),
        position=np.array([[6.0, 0.0], [6.0, 4.0]]),
        covariance=np.array([[[4e-5, 1e-5], [1e-5, 2e-5]], np.full((2, 2), np.nan)]),
        walls=np.array([[0, 1], [1, 3]]),
        observations=np.array([3, 2]),
    )
    stamps = np.linspace(0, 20, 101)
    poses = np.column_stack([1 + 0.2 * stamps, 2 + np.sin(stamps / 4), np.arctan2(np.cos(stamps / 4) / 4, 0.2)])
    keyframes = Keyframes.without_covariance(stamps[::20], poses[::20])
    return Finished(lines, corners, keyframes, stamps, poses, {"closures": 0})


@pytest.fixture
def fake_slam(monkeypatch: pytest.MonkeyPatch, finished: Finished) -> Iterator[type]:
    """Replacement of the pipeline that returns odometry and a fixed map, and fails on demand."""

    class FakeSlam:
        fails: BaseException | None = None
        notices = 0
        refined = False
        extends_map = True
        lidar_mounts: ClassVar[list[np.ndarray]] = []

        def __init__(self, config: Config, sinks: Sequence[Any], *, refine: bool = False, **_: object) -> None:
            self.config, self.sinks = config, sinks
            type(self).refined = refine
            self.odometry: list[Odometry] = []

        def add(self, message: Message) -> None:
            if isinstance(message, Odometry):
                self.odometry.append(message)
            elif isinstance(message, Scan) and self.fails is not None:
                raise self.fails

        @property
        def session(self) -> StoredSession:
            history = OdometryHistory()
            for reading in self.odometry:
                history.add(reading)
            return StoredSession(Config(), SlamState(Config()), [], [history], [0], LearnedNoise(0.01, 0.001, 0.01))

        def finish(self) -> Finished:
            for k in range(self.notices):
                for sink in self.sinks:
                    sink.handle(Notice(float(k), f"notice number {k}"))
            return replace(
                finished,
                stamps=np.array([o.stamp for o in self.odometry]),
                poses=np.array([o.pose for o in self.odometry]),
            )

    monkeypatch.setattr("slam.warmup.warm_up", lambda: None)  # first, as importing it imports the real pipeline
    with replaced(sys.modules["slam.pipeline"], "Slam", FakeSlam):
        yield FakeSlam


class Wclm:
    """Commands run in this process, in an empty directory."""

    def __call__(self, *arguments: object) -> Result:
        return CliRunner().invoke(app, [str(argument) for argument in arguments])

    def refuses(self, *arguments: object, because: Sequence[str]) -> None:
        """Assert that a command fails with one line on stderr that contains `because`, and exit status 2."""
        result = self(*arguments)
        assert result.exit_code == 2, result.output
        assert isinstance(result.exception, SystemExit)
        assert len(result.stderr.splitlines()) == 1, result.stderr
        assert result.stderr.startswith("wclm: ")
        assert result.stdout == ""
        for words in because:
            assert words in result.stderr


@pytest.fixture
def wclm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Wclm:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    return Wclm()


class MapServer:
    """Occupancy map read as nav2_map_server and map_server read it, according to their documentation."""

    def __init__(self, yaml: Path) -> None:
        settings = YAML(typ="safe").load(yaml.read_text())
        assert set(settings) == {"image", "mode", "resolution", "origin", "negate", "occupied_thresh", "free_thresh"}
        assert settings["mode"] == "trinary"
        self.resolution, self.origin = settings["resolution"], settings["origin"]
        magic, size, maximum, pixels = (yaml.parent / settings["image"]).read_bytes().split(b"\n", 3)
        assert (magic, maximum) == (b"P5", b"255")
        self.width, self.height = (int(word) for word in size.split())
        picture = np.frombuffer(pixels, np.uint8).reshape(self.height, self.width)
        shade = picture / 255.0
        occupied = shade if settings["negate"] else 1.0 - shade
        trinary = np.full(picture.shape, -1)
        trinary[occupied > settings["occupied_thresh"]] = 100
        trinary[occupied < settings["free_thresh"]] = 0
        self.data = np.empty(self.width * self.height, int)
        for row in range(self.height):  # data starts with the lowest y, the picture with the highest
            start = (self.height - row - 1) * self.width
            self.data[start : start + self.width] = trinary[row]

    def occupied(self) -> np.ndarray:
        """Return the centres (n, 2) of the occupied cells, metres."""
        rows, columns = np.nonzero(self.data.reshape(self.height, self.width) == 100)
        return np.column_stack([columns + 0.5, rows + 0.5]) * self.resolution + self.origin[:2]

    def at(self, x: float, y: float) -> int:
        column = int(np.floor((x - self.origin[0]) / self.resolution))
        row = int(np.floor((y - self.origin[1]) / self.resolution))
        assert 0 <= column < self.width
        assert 0 <= row < self.height
        return int(self.data[row * self.width + column])


@pytest.fixture
def map_server() -> type[MapServer]:
    return MapServer


@pytest.fixture(scope="session")
def corridor(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Event]]:
    """One lap logged, slowly enough that nothing is left out: the file and the events."""
    path = tmp_path_factory.mktemp("review") / "review.rrd"
    events = list(Corridor().events())
    versions = {"wclm-slam": "0.1.0"}
    with ReviewLog(path, config="[lidar]\nsigma_range = 0.01", recording="corridor", versions=versions) as review:
        for event in events:
            review.handle(event)
            while review.waiting > 50:
                time.sleep(0.001)
    assert (review.failures, review.thinned, review.lost) == (0, 0, 0), review.first_failure
    return path, events


@pytest.fixture(scope="session")
def closure_log(corridor: tuple[Path, list[Event]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Log of the same lap with a loop closure, to be read only."""
    return write(tmp_path_factory.mktemp("review") / "closure.rrd", with_closure(corridor[1]))
