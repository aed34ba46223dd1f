"""Every command in the README and the documentation exists, accepts its options, and runs."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.main import get_command

from drivers.devices.device_spec import parse_devices
from slam.cli.app import app

from .blocks import NEEDS, PAGES, ROOT, Block, blocks, mentions
from .conftest import DURATION, HALL, Reader, fill, simulations_of

PLACEHOLDERS = {"FILE", "FORMAT", "WORLD", "SESSION", "DIR", "RECORDING", "GRAPH"}
OTHER_PROGRAMS = {
    *("make", "pip", "python3", "sudo", ".", "rerun", "dask", "ros2"),
    *("cmake", "git", "journalctl", "kill", "mkdir", "scp", "sleep", "timeout", "tmux", "watch"),
}
"""Other commands, by their names without a folder; those of `make` that runs here must be targets."""
SHORTER = {"--seeds": "1", "--runs": "2", "--count": "5", "--laps": "1"}
"""Smaller values for options that determine the duration of benchmarks."""
EARLIER = {"--scan": "30"}
"""Smaller values for options that presuppose a longer drive."""
OF_SEVERAL_DRIVES = ("docs/changes.md", "docs/merge.md")
"""Pages with blocks that need recordings of two drives through one building."""
LONGER = 18.0
"""Duration of drives that are to be recognised in maps of each other, seconds."""
command_line: Any = cache(get_command)
MENTIONS = mentions()
WITH_BLOCKS = sorted({block.page for block in blocks()})
FAST_PAGES = ("README.md", "docs/getting-started.md", "docs/contributing.md", "docs/exports.md", "docs/faq.md")
"""Those with the first steps, and some with few blocks."""


def with_values(words: list[str], values: dict[str, str]) -> list[str]:
    """Return the words of a command with other values of the options in `values`."""
    return [values.get(before, word) for before, word in zip(["", *words], words, strict=False)]


def slow_blocks() -> list[Block]:
    """Return the blocks that take minutes, without those whose commands are a part of another one."""
    slow = {block: {tuple(words) for words in block.commands()} for block in blocks() if block.needs == "time"}
    return [block for block, commands in slow.items() if not any(commands < others for others in slow.values())]


def parse_command(words: list[str]) -> None:
    """Parse a command and its device specs without running it; raises the errors of the command line."""
    command = command_line(app)
    context = typer.Context(command, info_name="wclm")
    while hasattr(command, "commands") and words:
        command = command.commands[words[0]]
        words = words[1:]
    if not hasattr(command, "commands"):
        parsed = command.make_context(command.name, list(words), parent=context).params
        for spec in [*(parsed.get("lidar") or []), *(parsed.get("base") or []), *(parsed.get("specs") or [])]:
            if ":" in spec:
                parse_devices(spec)


def test_requirements_are_known_and_all_blocks_are_found() -> None:
    assert {block.needs for block in blocks()} <= NEEDS | {""}
    assert "README.md" in WITH_BLOCKS
    for name, page in PAGES.items():
        found = sum(block.page == name for block in blocks())
        text = page.read_text(encoding="utf-8")
        assert found == text.count("```sh\n") + text.count("```python\n"), name


@pytest.mark.parametrize("block", [block for block in blocks() if block.language == "sh"], ids=str)
def test_commands_in_blocks_exist(block: Block) -> None:
    targets = {line.split(":")[0] for line in (ROOT / "Makefile").read_text().splitlines() if line[:1].isalpha()}
    for words in block.commands():
        program = words[0].rsplit("/", 1)[-1]
        if program == "wclm":
            if words[1:] not in (["--help"], ["--version"]):
                parse_command(words[1:])
        else:
            assert program in OTHER_PROGRAMS, words
            assert program != "make" or words[1] in {*targets, "-C"}
            assert block.needs not in ("", "emulator", "time"), f"{block}: {program} cannot be run by a test"


@pytest.mark.parametrize("page", sorted({page for page, _ in MENTIONS}))
def test_commands_in_sentences_exist(page: str) -> None:
    for of_page, words in MENTIONS:
        if of_page == page:
            assert_exists(words)


def assert_exists(words: list[str]) -> None:
    """Assert that a command within a sentence exists, with the options that it has there."""
    command = command_line(app)
    rest = words[1:]
    while hasattr(command, "commands") and rest:
        assert rest[0] in command.commands or rest[0] in PLACEHOLDERS, words
        command, rest = command.commands.get(rest[0]), rest[1:]
        if command is None:
            return
    known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
    assert {word for word in rest if word.startswith("--")} <= known, words


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=[] if page in FAST_PAGES else pytest.mark.slow) for page in WITH_BLOCKS],
)
def test_blocks_run_in_order(page: str, reader: Reader) -> None:
    with simulations_of(DURATION):
        for block in blocks():
            if block.page != page or block.needs:
                continue
            if block.language == "python":
                exec(compile(block.text, str(block), "exec"), {"__name__": "__main__"})
            else:
                for words in block.commands():
                    reader.run(with_values(words, EARLIER))


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("block", slow_blocks(), ids=str)
def test_slow_blocks_run(block: Block, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with simulations_of(100.0):
        fill(tmp_path)
    for words in block.commands():
        Reader(tmp_path).run(with_values(words, SHORTER))


@pytest.mark.slow
def test_commands_of_the_readme_with_several_drives_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run them with drives through one hall; `wclm batch`, which starts processes, has its own tests."""
    monkeypatch.chdir(tmp_path)
    (block,) = (block for block in blocks() if block.page == "README.md" and block.needs == "drives")
    with simulations_of(LONGER):
        fill(tmp_path, HALL)
        reader = Reader(tmp_path)
        for line in (
            "simulate room.toml tuesday/a.mcap --seed 2",
            "run tuesday/a.mcap --out maps/b --no-review",
            "map map --format dxf --out plan.dxf",
        ):
            reader.run(["wclm", *line.split()])
        shutil.copytree("map", "maps/a")
        for words in block.commands():
            if words[1] != "batch":
                reader.run(words, statuses=(0, 1) if words[1] == "diff" else (0,))


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("page", OF_SEVERAL_DRIVES)
def test_blocks_with_several_drives_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run them with drives of 100 s through the simulated office."""
    monkeypatch.chdir(tmp_path)
    for seed, name in enumerate(("monday", "tuesday"), start=1):
        words = ["wclm", "simulate", "office", f"{name}.mcap", "--seed", str(seed), "--duration", "100"]
        Reader(tmp_path).run(words)
    for block in blocks():
        if block.page == page and block.needs == "drives":
            for words in block.commands():
                differs = words[1] == "diff"  # the other drive may have seen a difference
                Reader(tmp_path).run(words, statuses=(0, 1) if differs else (0,))


@pytest.mark.slow
def test_blocks_with_an_emulated_robot_run(tmp_path: Path) -> None:
    """The first block starts the emulator, the others use it for some seconds."""
    (start,), *others = [
        block.commands()
        for block in blocks()
        if block.page.endswith("getting-started.md") and block.needs == "emulator"
    ]
    program = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from slam.cli import main; main()"
    )

    def process(words: list[str]) -> subprocess.Popen[str]:
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        return subprocess.Popen([sys.executable, "-c", program, *words[1:]], cwd=tmp_path, text=True, env=environment)

    robot = process(start)
    try:
        deadline = time.monotonic() + 120
        while not (tmp_path / "robot" / "base").exists() and time.monotonic() < deadline:
            time.sleep(0.1)
        for words in (words for commands in others for words in commands):
            limited = [*words, "--duration", "15", "--no-serve"] if words[1] == "live" else words
            assert process(limited).wait(200) == 0, words
            if words[1] == "live":
                robot.send_signal(signal.SIGINT)
                robot.wait(60)
    finally:
        robot.kill()
