"""Damage of one value after the other, and the commands that read it: `python -m tests.fuzzing.sweeps --help`.

Each value of JSON, of settings, and of columns of text and of tables is replaced by values of other kinds, left out or
cut off. A command then succeeds, or it prints one line that names the file, has exit status 2 and writes nothing.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rosbags.rosbag2 import StoragePlugin
from typer.testing import CliRunner

from drivers.recordings.ros_encoder import RosEncoder
from drivers.simulation import LidarModel, Simulation
from slam.cli.app import app
from slam.io.output_dir import CONFIG, KEYFRAMES, MAP, SESSION, SUMMARY, TRAJECTORY
from slam.warmup import warm_up

from ..drivers.conftest import ros_entries, write_bag2
from .damages import (
    Damage,
    damaged_attributes,
    damaged_json,
    damaged_lines,
    damaged_rows,
    damaged_settings,
    damaged_table,
)
from .worker import MAX_MEMORY, peak_memory

MAX_SECONDS = 5.0
"""Processor time of a command."""
DRIVE = "sim:office?seed=3&duration=5&lidar=short"


@dataclass(frozen=True)
class Sweep:
    """Damaged file and the commands that read it.

    file      in the folder of all files
    damages   yields the damaged contents for the intact one
    commands  arguments of commands, run in that folder; `out` is a directory or file that is written
    named     what an error must name; by default the file
    """

    file: str
    damages: Callable[[bytes], Iterator[Damage]]
    commands: Sequence[str]
    named: str = ""


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
TABLE_COMMANDS = ("measure run", "optimize run --out out --no-review")
TABLES = (
    "corners", "factors", "keyframes", "loop_decisions", "odometry", "queued_scans", "recent_keyframes", "scans",
    "variables", "walls",
)  # fmt: skip
"""Tables of a session."""
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
    Sweep("plan.dxf", damaged_lines, (f"run {DRIVE} --plan plan.dxf --out out --no-review",)),
    Sweep("plan.svg", damaged_attributes, (f"run {DRIVE} --plan plan.svg --out out --no-review",)),
    Sweep("bag/metadata.yaml", damaged_settings, ("info bag", "run bag --out out --no-review"), named="bag"),
    *(Sweep(f"run/{SESSION}/{name}.parquet", damaged_table, TABLE_COMMANDS, named=SESSION) for name in TABLES),
]


def make_files(folder: Path) -> None:
    """Write all files that are damaged, and what their commands need besides them."""
    for name, drive in (("run", "seed=4&duration=12"), ("other", "seed=5&duration=14")):
        succeed(["run", f"sim:office?{drive}&lidar=short", "--out", str(folder / name), "--no-review"])
    succeed(["correct", str(folder / "run"), "--delete-wall", "0", "--out", str(folder / "corrected")])
    for suffix in ("geojson", "dxf", "svg"):
        succeed(["map", str(folder / "other"), "--format", suffix, "--out", str(folder / f"plan.{suffix}")])
    messages = list(Simulation("room", seed=3, duration=2.0, lidar=LidarModel(beams=90, rate=5.0)))
    write_bag2(folder / "bag", ros_entries(messages, RosEncoder()), StoragePlugin.SQLITE3)
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


def failure_of(folder: Path, named: str, command: str) -> str:
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
    if named not in lines[-1]:
        return f"does not name {named}: {lines[-1]}"
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
            file.write_bytes(content())
            try:
                failure = failure_of(folder, sweep.named or file.name, command)
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
