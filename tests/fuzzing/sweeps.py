"""Damage of one value after the other, and the commands that read it: `python -m tests.fuzzing.sweeps --help`.

Each value of JSON, each column of text, and each value of settings is replaced by values of other kinds, left out or
cut off. A command then succeeds, or it prints one line that names the file, has exit status 2 and writes nothing.
"""

from __future__ import annotations

import argparse
import copy
import json
import os
import re
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from slam.cli.app import app
from slam.io.output_dir import CONFIG, KEYFRAMES, MAP, SESSION, SUMMARY, TRAJECTORY
from slam.warmup import warm_up

from .worker import MAX_MEMORY, peak_memory

MAX_SECONDS = 5.0
"""Processor time of a command."""
VALUES: tuple[Any, ...] = (
    None, True, 0, -1, 2**31, 10**25, 0.5, 1e300, float("nan"), float("inf"), "", "x", [], {}, [[1.0]], {"x": 1},
)  # fmt: skip
WORDS = ("", "x", "nan", "inf", "-1", "0", "1e300", "1" + "0" * 30, "null", '"', "\x00", "1e-300")
MORE = b"\n1,2\n"
"""What is appended to a text."""
DRIVE = "sim:office?seed=3&duration=12"
Damage = tuple[str, bytes]
"""What was changed, and the damaged content."""


@dataclass(frozen=True)
class Sweep:
    """Damaged file and the commands that read it.

    file      in the folder of all files
    damages   yields the damaged contents for the intact one
    commands  arguments of commands, run in that folder; `out` is a directory or file that is written
    """

    file: str
    damages: Callable[[bytes], Iterator[Damage]]
    commands: Sequence[str]


def damaged_json(data: bytes) -> Iterator[Damage]:
    """Yield JSON with each value replaced or left out; of a list, the first one and the last one."""
    yield from damaged_ends(data)
    tree = json.loads(data)
    for keys in places(tree):
        for value in VALUES:
            changed = copy.deepcopy(tree)
            inner(changed, keys)[keys[-1]] = value
            yield f"{keys} = {value!r}"[:200], json.dumps(changed).encode()
        changed = copy.deepcopy(tree)
        del inner(changed, keys)[keys[-1]]
        yield f"{keys} left out", json.dumps(changed).encode()


def places(tree: Any, before: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the keys that lead to each value of a tree; of a list, to the first one and the last one."""
    keys = (
        list(tree) if isinstance(tree, dict) else sorted({0, len(tree) - 1}) if isinstance(tree, list) and tree else []
    )
    for key in keys:
        yield (*before, key)
        yield from places(tree[key], (*before, key))


def inner(tree: Any, keys: tuple[Any, ...]) -> Any:
    """Return the part of a tree that has the last of some keys."""
    for key in keys[:-1]:
        tree = tree[key]
    return tree


def damaged_rows(data: bytes) -> Iterator[Damage]:
    """Yield lines of columns with each column replaced, left out or repeated: in the first, second and last line."""
    yield from damaged_ends(data)
    lines = data.decode().splitlines()
    separator = "," if "," in lines[-1] else " "
    for row in sorted({0, 1, len(lines) - 1} & set(range(len(lines)))):
        cells = lines[row].split(separator)
        for column in range(len(cells)):
            for word in WORDS:
                yield from _with_cells(lines, row, separator, [*cells[:column], word, *cells[column + 1 :]])
            yield from _with_cells(lines, row, separator, [*cells[:column], *cells[column + 1 :]])
            yield from _with_cells(lines, row, separator, [*cells[: column + 1], *cells[column:]])
        yield f"line {row} left out", "\n".join([*lines[:row], *lines[row + 1 :], ""]).encode()
        yield f"line {row} twice", "\n".join([*lines[: row + 1], *lines[row:], ""]).encode()


def _with_cells(lines: list[str], row: int, separator: str, cells: list[str]) -> Iterator[Damage]:
    line = separator.join(cells)
    yield f"line {row}: {line}"[:200], "\n".join([*lines[:row], line, *lines[row + 1 :], ""]).encode()


def damaged_settings(data: bytes) -> Iterator[Damage]:
    """Yield settings in TOML or YAML with each value replaced, or its line left out."""
    yield from damaged_ends(data)
    text = data.decode()
    for place in re.finditer(r"(?<=[=:])[ \t]*\S[^\n]*", text):
        for word in (*WORDS, "[]", "{}", "true", "[1, 2]", "nan, nan", "[nan, 0, 0]"):
            yield f"{place[0].strip()} -> {word}"[:200], f"{text[: place.start()]} {word}{text[place.end() :]}".encode()
    for line in re.finditer(r"[^\n]+\n", text):
        yield f"{line[0].strip()} left out"[:200], f"{text[: line.start()]}{text[line.end() :]}".encode()


def damaged_ends(data: bytes) -> Iterator[Damage]:
    """Yield content that is empty, cut off, longer, binary or of another encoding."""
    yield "empty", b""
    for share in (0.01, 0.5, 0.99):
        yield f"cut off after {share:g}", data[: int(share * len(data))]
    yield "more", data + MORE
    yield "binary", bytes(range(256))
    yield "UTF-16", data.decode(errors="replace").encode("utf-16")


SESSION_COMMANDS = (
    "report run --out out.html",
    "map run --format svg --out out.svg",
    "map run --format geojson --out out.geojson",
    "map run --format dxf --out out.dxf",
    "map run --format pgm --out out.pgm",
    "map run --format ply --out out.ply",
    "map run --format g2o --out out.g2o",
    "measure run",
    "diff run other",
    "correct run --delete-wall 0 --out out",
    "correct run --list",
    "optimize run --out out --no-review",
    "merge run other --out out --no-review",
    f"run {DRIVE} --continue run --out out --no-review",
    f"run {DRIVE} --localize run --out out --no-review",
    f"run {DRIVE} --plan run --out out --no-review",
    "eval run --reference other",
)
CORRECTION_COMMANDS = (
    "correct corrected --list",
    "correct corrected --undo --out out",
    "correct corrected --delete-wall 1 --out out",
    "report corrected --out out.html",
)
WORLD_COMMANDS = ("simulate world.toml out.mcap --duration 1", "run sim:world.toml?duration=3 --out out --no-review")
SWEEPS = [
    Sweep(f"run/{SUMMARY}", damaged_json, SESSION_COMMANDS),
    Sweep(f"run/{MAP}", damaged_json, SESSION_COMMANDS),
    Sweep(f"run/{TRAJECTORY}", damaged_rows, SESSION_COMMANDS),
    Sweep(f"run/{KEYFRAMES}", damaged_rows, SESSION_COMMANDS),
    Sweep(f"run/{CONFIG}", damaged_settings, SESSION_COMMANDS),
    Sweep(f"run/{SESSION}/session.json", damaged_json, ("measure run",)),
    Sweep(f"corrected/{SESSION}/corrections.json", damaged_json, CORRECTION_COMMANDS),
    Sweep("pins.csv", damaged_rows, ("correct run --pins pins.csv --out out",)),
    Sweep("plan.geojson", damaged_json, (f"run {DRIVE} --plan plan.geojson --out out --no-review",)),
    Sweep("grid.yaml", damaged_settings, (f"run {DRIVE} --plan grid.yaml --out out --no-review",)),
    Sweep("settings.toml", damaged_settings, (f"run {DRIVE} --config settings.toml --out out --no-review",)),
    Sweep("world.toml", damaged_settings, WORLD_COMMANDS),
    Sweep("a.relations", damaged_rows, ("eval run --relations a.relations",)),
    Sweep("reference.tum", damaged_rows, ("eval run --reference reference.tum",)),
]


def make_files(folder: Path) -> None:
    """Write all files that are damaged, and what their commands need besides them."""
    for name, drive in (("run", "office?seed=4&duration=12"), ("other", "office?seed=5&duration=25")):
        succeed(["run", f"sim:{drive}", "--out", str(folder / name), "--no-review"])
    succeed(["correct", str(folder / "run"), "--delete-wall", "0", "--out", str(folder / "corrected")])
    succeed(["map", str(folder / "other"), "--format", "geojson", "--out", str(folder / "plan.geojson")])
    succeed(["map", str(folder / "other"), "--format", "pgm", "--out", str(folder / "grid.pgm")])
    lines = (folder / "run" / TRAJECTORY).read_text().splitlines()
    (folder / "reference.tum").write_text("\n".join(lines[::3]) + "\n")
    stamps = [line.split()[0] for line in lines]
    (folder / "a.relations").write_text(
        "".join(f"{a} {b} 0.1 0 0 0 0 0\n" for a, b in zip(stamps, stamps[3:], strict=False))
    )
    (folder / "pins.csv").write_text(
        "kind,id,x,y,sigma,heading,sigma_heading\n"
        f"pose,{stamps[0]},1,2,0.01,,\npose,{stamps[-1]},1,2,0.01,-0.5,0.02\nwall,1,3,4,0.01,,\n"
    )
    (folder / "settings.toml").write_text(
        "[lidar]\nsigma_range = 0.01\nmount = [0.1, 0.0, 0.0]\ndelay = 0.01\nrange_max = 20.0\n"
        "[odometry]\nsource = 'wheels'\ntranslation_error = 0.1\n[mapping]\nkeyframe_distance = 0.5\n"
    )
    (folder / "world.toml").write_text(
        'title = "a"\nspeed = 0.4\npath = [[1.0, 1.0], [5.0, 1.0], [5.0, 3.2]]\n'
        "[[walls]]\nfrom = [0, 0]\nto = [6, 0]\n[[boxes]]\nat = [3.0, 2.1]\nsize = [1.2, 0.7]\nturn = 10\n"
    )


def succeed(arguments: Sequence[str]) -> None:
    ended = CliRunner().invoke(app, arguments)
    assert ended.exit_code == 0, ended.output


def failure_of(folder: Path, file: Path, command: str) -> str:
    """Run a command in the present directory `folder`; return what is wrong with it, empty if nothing is."""
    peak_memory()  # begins a new measurement
    before, started, used = listing(folder), time.process_time(), peak_memory()
    result = CliRunner().invoke(app, command.split())
    took, added = time.process_time() - started, listing(folder) - before
    remove(folder, added)
    if (memory := peak_memory() - used) > MAX_MEMORY:
        return f"needs {memory} MB"
    if took > MAX_SECONDS:
        return f"takes {took:.1f} s"
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        return "".join(traceback.format_exception(result.exception))[-1500:]
    lines = [line for line in result.stderr.splitlines() if line.startswith("wclm: ")]
    if result.exit_code == 0:
        return ""
    if result.exit_code == 1 and command.startswith("eval"):  # relations outside of the trajectory's time
        return ""
    if result.exit_code != 2 or result.stderr.splitlines()[-1:] != lines[-1:]:
        return f"exit status {result.exit_code}: {result.output[-500:]}"
    if file.name not in lines[-1]:
        return f"does not name the file: {lines[-1]}"
    return f"leaves {sorted(added)[0]} behind: {lines[-1]}" if added else ""


def listing(folder: Path) -> set[Path]:
    return set(folder.rglob("*"))


def remove(folder: Path, added: set[Path]) -> None:
    """Remove what a command has written."""
    for path in sorted(added, reverse=True):
        path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()


def failures(folder: Path, sweep: Sweep, step: int = 1) -> Iterator[str]:
    """Yield the failures of each `step`-th command of a sweep; the present directory is `folder`."""
    file, number = folder / sweep.file, -1
    intact = file.read_bytes()
    for name, content in sweep.damages(intact):
        for command in sweep.commands:
            number += 1
            if number % step:
                continue
            file.write_bytes(content)
            try:
                failure = failure_of(folder, file, command)
            finally:
                file.write_bytes(intact)
            if failure:
                yield f"{sweep.file}: {name}: wclm {command}: {failure}"


def main() -> None:
    parser = argparse.ArgumentParser(description="Run commands on damaged files; the exit status is 1 if one fails.")
    parser.add_argument("files", nargs="*", help="ends of the names of files; all by default")
    parser.add_argument("--step", type=int, default=1, help="only every so many commands (default: %(default)s)")
    arguments = parser.parse_args()
    count = 0
    with tempfile.TemporaryDirectory() as name:
        warm_up()
        make_files(Path(name))
        os.chdir(name)
        for sweep in SWEEPS:
            if not sweep.file.endswith(tuple(arguments.files or [""])):
                continue
            for failure in failures(Path(name), sweep, arguments.step):
                count += 1
                print(failure, flush=True)
    print(f"{count} commands fail")
    sys.exit(1 if count else 0)


if __name__ == "__main__":
    main()
