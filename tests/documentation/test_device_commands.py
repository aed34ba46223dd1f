"""Commands of the documentation that use a lidar and a wheel base run on an emulated robot."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from ..slam.robot import SLOW_LIDAR, Robot
from .blocks import blocks
from .conftest import DURATION, simulations_of, wclm

SECONDS = "1.5"
"""Duration of each command, seconds."""
LIDAR, BASE = "rplidar:robot/lidar", "create2:robot/base"
PORTS = {
    "rplidar:/dev/ttyUSB0": LIDAR, "rplidar:/dev/lidar": LIDAR, "rplidar:auto": LIDAR, "rplidar:robot/lidar": LIDAR,
    "create2:/dev/ttyUSB1": BASE, "create2:/dev/base": BASE, "create2:robot/base": BASE,
}  # fmt: skip
"""Devices of the pages, and the emulated ones that take their places."""
COMMANDS = {"live", "record", "devices"}
UNTIL_STOPPED = {"--watch", "--drive", "--web", "--web-address"}
"""Options of commands that wait for a person or a browser; tests of these options are elsewhere."""


def on_the_robot(words: list[str]) -> list[str]:
    """Return the words of a command with the emulated devices, and results in the present directory."""
    replaced = []
    for word in words[1:]:
        kind, mark, options = word.partition("?")
        replaced.append(PORTS.get(kind, kind.replace("~/", "")) + mark + options)
    return replaced if replaced[0] == "devices" else [*replaced, "--duration", SECONDS]


def device_commands() -> list[list[str]]:
    """Return the commands of all pages that can be run on the emulated robot, one of those with the same options."""
    found: dict[tuple[str, ...], list[str]] = {}
    for block in blocks():
        for words in block.commands() if block.language == "sh" else []:
            program, *rest = words
            if not program.endswith("wclm") or rest[0] not in COMMANDS or UNTIL_STOPPED & set(rest):
                continue
            devices = [word.partition("?")[0] for word in rest if ":" in word]
            if set(devices) <= set(PORTS):
                options = sorted(word for word in rest if word.startswith("--"))
                found.setdefault((rest[0], str(bool(devices)), *options), on_the_robot(words))
    return list(found.values())


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Directory with the ports of an emulated robot in `robot`."""
    folder = tmp_path_factory.mktemp("emulated")
    with Robot(folder, "office", *SLOW_LIDAR):
        yield folder


def test_most_commands_with_devices_can_be_run() -> None:
    assert {words[0] for words in device_commands()} == COMMANDS
    assert sum(words[0] == "live" for words in device_commands()) >= 3


@pytest.mark.slow
def test_commands_with_devices_run_on_an_emulated_robot(robot: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(robot)
    given = {path.name for path in robot.iterdir()}
    with simulations_of(DURATION):
        for words in device_commands():
            if "--continue" in words:
                assert wclm("simulate", "office", "before.mcap", "--duration", "3").exit_code == 0
                assert wclm("run", "before.mcap", "--out", "map", "--no-review").exit_code == 0
            result = wclm(*words)
            assert result.exit_code == 0, f"{' '.join(words)}: {result.output}"
            for path in robot.iterdir():
                if path.name not in given:
                    shutil.rmtree(path) if path.is_dir() else path.unlink()
