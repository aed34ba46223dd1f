"""Sessions, maps, plans and recordings of strangers: no command runs code from them or writes outside of its output."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from slam.cli.app import app
from slam.config import Config
from slam.io.output_dir import SUMMARY
from slam.io.work_directory import left_behind

WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
PATHS = {
    "os.rename": 2, "os.remove": 1, "os.mkdir": 1, "os.rmdir": 1, "os.symlink": 2, "os.link": 2, "os.truncate": 1,
    "os.chmod": 1, "os.chown": 1, "os.utime": 1, "os.mkfifo": 1,
}  # fmt: skip
"""Events with the number of their arguments that are paths which they change."""
FORBIDDEN = {
    "os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "os.kill", "os.killpg",
    "subprocess.Popen", "socket.connect",
}  # fmt: skip


class Watch:
    """Audit hook of the interpreter; it cannot be removed, so it is switched on and off.

    written    paths that were created, changed or removed
    forbidden  other events
    """

    def __init__(self) -> None:
        self.on, self.written, self.forbidden = False, list[Path](), list[str]()
        sys.addaudithook(self._handle)

    @contextmanager
    def watching(self) -> Iterator[None]:
        self.written, self.forbidden, self.on = [], [], True
        try:
            yield
        finally:
            self.on = False

    def _handle(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.on:
            return
        if event == "open" and isinstance(arguments[0], str | bytes):
            mode, flags = arguments[1], arguments[2]
            if (isinstance(mode, str) and set(mode) & set("wax+")) or (mode is None and flags & WRITES):
                self._add(arguments[0])
        elif event in PATHS:
            for path in arguments[: PATHS[event]]:
                self._add(path)
        elif event in FORBIDDEN or (event == "pickle.find_class" and _is_harmful(*arguments)):
            self.forbidden.append(f"{event} {arguments}")

    def _add(self, path: Any) -> None:
        if isinstance(path, str | bytes | os.PathLike):
            self.on = False
            self.written.append(Path(os.fsdecode(path)).absolute())
            self.on = True


def _is_harmful(module: str, name: str) -> bool:
    """Return True if a pickle needs a function that runs code. Compiled code is loaded from pickles with others."""
    return module in ("os", "posix", "subprocess") or (module == "builtins" and name != "object")


@pytest.fixture(scope="module")
def watch() -> Watch:
    return Watch()


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a recording and the output directory of its run."""
    folder = tmp_path_factory.mktemp("mapped")
    for arguments in (
        ["simulate", "room", folder / "drive.mcap", "--duration", 4],
        ["run", folder / "drive.mcap", "--out", folder / "map", "--no-review"],
    ):
        result = CliRunner().invoke(app, [str(argument) for argument in arguments])
        assert result.exit_code == 0, result.output
    return folder


class Pickled:
    """Object that runs code when it is unpickled."""

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[str]]:
        return os.system, ("touch executed",)


CODE = pickle.dumps(Pickled())
TAGS = (
    "!!python/object/apply:os.system ['touch executed']\n",
    "image: !!python/object/apply:os.system ['touch executed']\nresolution: 0.05\norigin: [0, 0, 0]\n",
    "image: map.pgm\nresolution: !!python/name:os.system\norigin: [0, 0, 0]\n",
)
TEXTS = ("$(touch executed); touch executed `touch executed`", "{__import__('os').system('touch executed')}")
COMMANDS = (
    ["run", "drive.mcap", "--continue", "map", "--no-review", "--out", "result"],
    ["run", "drive.mcap", "--localize", "map", "--no-review", "--out", "result"],
    ["optimize", "map", "--no-review", "--out", "result"],
    ["correct", "map", "--delete-wall", "0", "--out", "result"],
    ["merge", "map", "map", "--out", "result"],
    ["map", "map", "--format", "geojson", "--out", "result"],
    ["map", "map", "--format", "pgm", "--out", "result"],
    ["measure", "map"],
    ["diff", "map", "map", "--svg", "result"],
    ["report", "map"],
    ["recover", "map"],
    ["save", "map"],
    ["eval", "map/trajectory.tum", "--reference", "map/trajectory.tum"],
)
EACH_COMMAND = [
    pytest.param(command, marks=[pytest.mark.slow] if command[0] in ("run", "merge") else []) for command in COMMANDS
]
"""Commands that read an output directory; only `report` and `recover` change it."""


def run(watch: Watch, folder: Path, *arguments: object) -> str:
    """Run a command in `folder`; assert that it neither ran code nor wrote outside of its output; return its output.

    The output is `folder`/result, a hidden work directory or file beside it, and the system's temporary directory.
    """
    own = arguments[1] if arguments[0] in ("report", "recover") else "result"
    with watch.watching():
        result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code in (0, 1, 2), (arguments, result.output, result.exception)
    assert result.exception is None or isinstance(result.exception, SystemExit), (arguments, result.exception)
    assert not watch.forbidden, (arguments, watch.forbidden)
    for path in set(watch.written) - {folder}:  # which is made if it does not exist
        if path.is_relative_to(folder):
            name = path.relative_to(folder).parts[0]
            assert name == own or name.startswith((f".{own}-", ".result-")), (arguments, path)
        else:
            assert "__pycache__" in path.parts or path.name.startswith(("wclm-", "tmp")), (arguments, path)
    assert not (folder / "executed").exists(), arguments
    return result.output


@pytest.fixture
def place(mapped: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with a copy of the recording and the map; it is the current one."""
    folder = tmp_path / "place"
    shutil.copytree(mapped, folder)
    monkeypatch.chdir(folder)
    return folder


def files_of(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def clean(folder: Path) -> None:
    result = folder / "result"
    if result.is_dir():
        shutil.rmtree(result)
    result.unlink(missing_ok=True)


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: "-".join(command[:1] + command[2:3]))
def test_pickles_instead_of_the_files_of_a_run_are_not_loaded(watch: Watch, place: Path, command: list[str]) -> None:
    for path in files_of(place / "map"):
        whole = path.read_bytes()
        path.write_bytes(CODE)
        run(watch, place, *command)
        path.write_bytes(whole)
        clean(place)


@pytest.mark.parametrize("command", EACH_COMMAND, ids=lambda command: "-".join(command[:1] + command[2:3]))
def test_texts_of_a_foreign_run_are_not_executed(watch: Watch, place: Path, command: list[str]) -> None:
    summary = json.loads((place / "map" / SUMMARY).read_text())
    for text in (*TEXTS, "../escaped", str(place / "escaped")):
        foreign = {key: text if isinstance(value, str) else value for key, value in summary.items()}
        foreign["recordings"] = [text]
        (place / "map" / SUMMARY).write_text(json.dumps(foreign))
        run(watch, place, *command)
        clean(place)
    assert not (place / "escaped").exists()
    assert not (place.parent / "escaped").exists()


@pytest.mark.parametrize("command", EACH_COMMAND, ids=lambda command: "-".join(command[:1] + command[2:3]))
def test_links_in_a_foreign_run_lead_to_no_changes_elsewhere(watch: Watch, place: Path, command: list[str]) -> None:
    elsewhere = place.parent / "elsewhere"
    elsewhere.mkdir()
    for path in files_of(place / "map"):
        moved = elsewhere / path.name
        path.rename(moved)
        path.symlink_to(moved)
    before = {path: path.read_bytes() for path in files_of(elsewhere)}
    run(watch, place, *command)
    assert {path: path.read_bytes() for path in files_of(elsewhere)} == before


def test_a_linked_directory_is_not_recovered(watch: Watch, place: Path) -> None:
    """What looks like the work directory of a killed run may be a link to any directory."""
    private = place.parent / "private"
    private.mkdir()
    for name in ("letter", "reserve", "running.json"):
        (private / name).write_text("private")
    (place / ".map-abcdefgh").symlink_to(private)
    (place / ".map-hgfedcba").mkdir()
    (place / ".map-hgfedcba-old").symlink_to(private)
    assert left_behind(place / "map") == [place / ".map-hgfedcba"]
    run(watch, place, "recover", "map")
    assert sorted(path.name for path in private.iterdir()) == ["letter", "reserve", "running.json"]


def test_a_prepared_name_of_a_temporary_file_is_not_written_through(watch: Watch, place: Path) -> None:
    letter = place.parent / "letter"
    letter.write_text("private")
    for name in ("map", "points", "result"):
        (place / "map" / f".{name}-{os.getpid()}.geojson").symlink_to(letter)
    assert "map.geojson" in run_in(watch, place)
    assert letter.read_text() == "private"


def run_in(watch: Watch, place: Path) -> str:
    with watch.watching():
        return CliRunner().invoke(app, ["map", "map", "--format", "geojson"]).output


@pytest.mark.parametrize("text", TAGS)
@pytest.mark.parametrize("name", ["map.yaml", "parameters.yaml", "bag/metadata.yaml"])
def test_tags_of_python_in_yaml_are_refused(watch: Watch, place: Path, text: str, name: str) -> None:
    (place / "bag").mkdir()
    (place / name).write_text(text)
    commands: dict[str, list[str]] = {
        "map.yaml": ["run", "drive.mcap", "--plan", "map.yaml", "--no-review", "--out", "result"],
        "parameters.yaml": ["ros", "--params-file", "parameters.yaml", "--out", "result"],
        "bag/metadata.yaml": ["run", "bag", "--no-review", "--out", "result"],
    }
    output = run(watch, place, *commands[name])
    assert output.startswith("wclm: "), output
    assert not (place / "result").exists()


@pytest.mark.parametrize("image", ["/dev/zero", "pipe"])
def test_a_picture_of_a_plan_must_be_a_file(watch: Watch, place: Path, image: str) -> None:
    os.mkfifo(place / "pipe")
    (place / "map.yaml").write_text(f"image: {image}\nresolution: 0.05\norigin: [0, 0, 0]\n")
    output = run(watch, place, "run", "drive.mcap", "--plan", "map.yaml", "--no-review", "--out", "result")
    assert "is not a file" in output


@pytest.mark.parametrize("recording", ["/dev/zero", "pipe", "/dev/zero.clf"])
def test_a_recording_that_a_session_names_must_be_a_file(watch: Watch, place: Path, recording: str) -> None:
    os.mkfifo(place / "pipe")
    summary = json.loads((place / "map" / SUMMARY).read_text())
    for key in ("recording_path", "recording"):
        summary[key] = recording if recording != "pipe" else str(place / "pipe")
    (place / "map" / SUMMARY).write_text(json.dumps(summary))
    run(watch, place, "map", "map", "--format", "pgm", "--out", "result")


@pytest.mark.parametrize("name", ["...mcap", "..mcap", ".mcap"])
def test_a_batch_writes_into_its_output_whatever_a_recording_is_called(place: Path, name: str) -> None:
    pytest.importorskip("distributed")
    from slam.offline.batch.jobs import JobOptions, make_jobs

    (place / "drive.mcap").rename(place / name)
    (job,) = make_jobs([str(place / name)], place / "maps", JobOptions(Config()))
    assert job.directory.resolve().parent == (place / "maps").resolve()
    assert job.log.resolve().is_relative_to((place / "maps").resolve())
