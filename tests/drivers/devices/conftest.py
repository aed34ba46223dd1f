"""Emulated devices in a process of their own, see `peer.py`."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest


class Peer:
    """The running program: paths of its terminals, its events, and its commands."""

    def __init__(self, directory: Path, *options: str) -> None:
        self.lidar, self.base = directory / "lidar", directory / "base"
        self.events: list[dict[str, Any]] = []
        self.process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("peer.py")), str(directory), *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._reader = threading.Thread(target=self._listen)
        self._reader.start()
        self.wait_for("ready")

    @property
    def spec(self) -> str:
        return f"rplidar:{self.lidar} + create2:{self.base}"

    def send_command(self, command: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()

    def wait_for(self, name: str, times: int = 1, timeout: float = 120.0) -> dict[str, Any]:
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            found = [event for event in list(self.events) if event["event"] == name]
            if len(found) >= times:
                return found[times - 1]
            time.sleep(0.01)
        raise AssertionError(f"{name} did not occur {times} times: {self.events}")

    def scans_since_last_stop(self) -> bool:
        kinds = [event["event"] for event in list(self.events) if event["event"] in ("stop", "scan")]
        return bool(kinds) and kinds[-1] == "scan"

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self._reader.join()
        for stream in (self.process.stdin, self.process.stdout):
            assert stream is not None
            stream.close()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.events.append(json.loads(line))


@pytest.fixture
def make_peer(tmp_path: Path) -> Iterator[Callable[..., Peer]]:
    made: list[Peer] = []

    def make(*options: str) -> Peer:
        directory = tmp_path / f"peer{len(made)}"
        directory.mkdir()
        made.append(Peer(directory, *options))
        return made[-1]

    yield make
    for peer in made:
        peer.close()


@pytest.fixture
def peer(make_peer: Callable[..., Peer]) -> Peer:
    return make_peer()
