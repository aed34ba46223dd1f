import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slam.config import Config, load_config
from slam.errors import OutputError
from slam.events import Finished
from slam.io.atomic_swap import exchange_directories
from slam.io.disk_reserve import MIN_RESERVE, directory_size
from slam.io.json_files import to_json_types
from slam.io.map_json import read_map
from slam.io.output_dir import CONFIG, KEYFRAMES, MAP, REVIEW, SUMMARY, TRAJECTORY, OutputDirectory
from slam.io.recovery import recover_results
from slam.io.run_results import write_results
from slam.io.tum import read_tum
from slam.io.unfinished_file import unfinished_file
from slam.io.work_directory import left_behind, running_process


def contents(folder: Path) -> dict[str, str]:
    return {file.name: file.read_text() for file in folder.iterdir()}


def test_directory_appears_when_all_results_are_written(tmp_path: Path, finished: Finished) -> None:
    out = tmp_path / "a" / "out"
    with OutputDirectory(out) as directory:
        write_results(directory, finished, Config(), {"scans": 3})
        assert not out.exists()
    assert sorted(file.name for file in out.iterdir()) == sorted([TRAJECTORY, KEYFRAMES, MAP, CONFIG, SUMMARY])
    assert [entry.name for entry in out.parent.iterdir()] == ["out"]
    assert len(read_tum(out / TRAJECTORY)) == len(finished.stamps)
    assert len(read_map(out / MAP).walls) == len(finished.walls)
    assert load_config(out / CONFIG) == Config()
    assert json.loads((out / SUMMARY).read_text()) == {"scans": 3}


def test_a_directory_that_another_run_is_writing_is_refused(tmp_path: Path) -> None:
    """Only one of both could be saved."""
    with (
        OutputDirectory(tmp_path / "out"),
        pytest.raises(OutputError, match="out: another run is writing it"),
        OutputDirectory(tmp_path / "out"),
    ):
        pass
    with OutputDirectory(tmp_path / "out", overwrite=True):
        pass


def test_the_current_directory_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It would be replaced, and the shell that is in it would not see the results."""
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    with pytest.raises(OutputError, match=r"^\.: is the current directory"), OutputDirectory(Path()):
        pass


def test_directory_has_default_permissions(tmp_path: Path) -> None:
    with OutputDirectory(tmp_path / "out"):
        pass
    (tmp_path / "other").mkdir()
    assert (tmp_path / "out").stat().st_mode == (tmp_path / "other").stat().st_mode


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("present", [False, True])
def test_nothing_changes_on_an_error(tmp_path: Path, error: type[BaseException], present: bool) -> None:
    out = tmp_path / "out"
    if present:
        out.mkdir()
        (out / SUMMARY).write_text("old")

    def write_and_fail() -> None:
        with OutputDirectory(out, overwrite=True) as directory:
            (directory / SUMMARY).write_text("new")
            raise error

    with pytest.raises(error):
        write_and_fail()
    assert [entry.name for entry in tmp_path.iterdir()] == (["out"] if present else [])
    assert not present or contents(out) == {SUMMARY: "old"}


def test_full_disk_is_an_output_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="out: cannot be written: No space left"), OutputDirectory(tmp_path / "out"):
        raise OSError(28, "No space left on device")
    assert not list(tmp_path.iterdir())


def test_existing_results_are_replaced_only_with_overwrite(tmp_path: Path) -> None:
    out = tmp_path / "out"
    for text in ("old", "new"):
        with OutputDirectory(out, overwrite=text == "new") as directory:
            (directory / SUMMARY).write_text(text)
            if text == "old":
                (directory / TRAJECTORY).write_text(text)
    assert contents(out) == {SUMMARY: "new"}
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]
    with pytest.raises(OutputError, match="out: exists already; choose another directory or add --overwrite"):
        OutputDirectory(out).__enter__()


SAVE_REPEATEDLY = """
import sys
from pathlib import Path
from slam.io.output_dir import SUMMARY, TRAJECTORY, OutputDirectory

for number in range(10**9):
    with OutputDirectory(Path(sys.argv[1]), overwrite=True) as directory:
        (directory / SUMMARY).write_text(f"{number}")
        (directory / TRAJECTORY).write_text(f"{number}")
    if number == 0:
        print("saved", flush=True)
"""


def test_results_are_complete_if_the_process_is_killed_at_any_time(tmp_path: Path) -> None:
    """A process that saves repeatedly is killed at random times."""
    out, random = tmp_path / "out", np.random.default_rng(1)
    for _ in range(5):
        with subprocess.Popen([sys.executable, "-c", SAVE_REPEATEDLY, out], stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"saved\n"
            time.sleep(random.uniform(0.0, 0.05))
            process.kill()
        saved = contents(out)
        assert saved[SUMMARY] == saved[TRAJECTORY] != ""


def test_results_are_replaced_if_directories_cannot_be_swapped_atomically(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slam.io.atomic_swap.swap_directories", lambda *_: False)
    for text in ("old", "new"):
        with OutputDirectory(tmp_path / "out", overwrite=True) as directory:
            (directory / SUMMARY).write_text(text)
    assert contents(tmp_path / "out") == {SUMMARY: "new"}
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]


def test_empty_directory_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with OutputDirectory(tmp_path / "out") as directory:
        (directory / SUMMARY).write_text("new")
    assert contents(tmp_path / "out") == {SUMMARY: "new"}


@pytest.mark.parametrize("name", ["map.dxf", "measurements.csv", "measurements.geojson", "points.ply"])
def test_exports_beside_the_results_are_replaced(tmp_path: Path, name: str) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).write_text("old")
    with OutputDirectory(tmp_path / "out", overwrite=True) as directory:
        (directory / SUMMARY).write_text("new")
    assert contents(tmp_path / "out") == {SUMMARY: "new"}


def test_directory_with_other_files_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(OutputError, match=r"contains thesis\.tex, which is not a result of a run; not overwritten"):
        OutputDirectory(tmp_path, overwrite=True).__enter__()


def test_file_in_place_of_the_directory_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("x")
    with pytest.raises(OutputError, match="out: is a file"):
        OutputDirectory(tmp_path / "out", overwrite=True).__enter__()
    with pytest.raises(OutputError, match=r"deeper: cannot be written: (Not a directory|File exists)"):
        OutputDirectory(tmp_path / "out" / "deeper").__enter__()


def test_results_are_kept_if_the_directory_was_created_meanwhile(tmp_path: Path) -> None:
    out = tmp_path / "out"
    directory = OutputDirectory(out)
    work = directory.__enter__()
    (work / SUMMARY).write_text("mine")
    out.mkdir()
    (out / SUMMARY).write_text("theirs")
    with pytest.raises(OutputError, match="the results are kept in") as caught:
        directory.__exit__(None, None, None)
    assert contents(out) == {SUMMARY: "theirs"}
    assert contents(work) == {SUMMARY: "mine"}
    assert str(work) in str(caught.value)


def test_unfinished_file_appears_at_the_end_or_not_at_all(tmp_path: Path) -> None:
    file = tmp_path / "a.mcap"

    def write_and_interrupt() -> None:
        with unfinished_file(file) as work:
            work.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_and_interrupt()
    assert not list(tmp_path.iterdir())
    with unfinished_file(file) as work:
        work.write_text("whole")
    assert contents(tmp_path) == {"a.mcap": "whole"}
    with pytest.raises(OutputError, match=r"a\.mcap: exists already"), unfinished_file(file):
        pass
    with unfinished_file(file, overwrite=True) as work:
        work.write_text("again")
    assert contents(tmp_path) == {"a.mcap": "again"}
    with pytest.raises(OutputError, match="there is no directory"), unfinished_file(tmp_path / "b" / "a.mcap"):
        pass


def test_data_is_converted_to_json_types() -> None:
    data = {"a": np.float64(1.5), "b": np.arange(2), "c": float("nan"), 3: (np.bool_(True), None), "p": Path("x")}
    expected = {"a": 1.5, "b": [0, 1], "c": None, "3": [True, None], "p": "x"}
    assert to_json_types(data) == expected
    json.dumps(to_json_types(data), allow_nan=False)


def write_text(text: str) -> Callable[[Path], None]:
    """Return a function that writes a summary."""
    return lambda place: void((place / SUMMARY).write_text(text))


def void(_: object) -> None:
    pass


def save_and_end(out: Path, error: BaseException | None) -> None:
    """Save a state over earlier results, then end with results or an error."""
    output = OutputDirectory(out, overwrite=True)
    with output as directory:
        output.save(write_text("saved"))
        assert contents(out) == {SUMMARY: "saved"}
        output.save(write_text("saved again"))
        if error is not None:
            raise error
        (directory / SUMMARY).write_text("final")


@pytest.mark.parametrize("present", [False, True])
def test_saved_states_are_replaced_by_the_results(tmp_path: Path, present: bool) -> None:
    out = earlier_results(tmp_path, present)
    save_and_end(out, None)
    assert contents(out) == {SUMMARY: "final"}
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("present", [False, True])
def test_a_saved_state_stays_after_an_error(tmp_path: Path, present: bool) -> None:
    out = earlier_results(tmp_path, present)
    with pytest.raises(RuntimeError):
        save_and_end(out, RuntimeError())
    assert contents(out) == {SUMMARY: "saved again"}
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("present", [False, True])
def test_discarding_restores_earlier_results(tmp_path: Path, present: bool) -> None:
    out = earlier_results(tmp_path, present)
    with pytest.raises(KeyboardInterrupt):
        save_and_end(out, KeyboardInterrupt())
    assert [entry.name for entry in tmp_path.iterdir()] == (["out"] if present else [])
    assert not present or contents(out) == {SUMMARY: "earlier"}


def test_a_state_that_cannot_be_written_leaves_the_one_before(tmp_path: Path) -> None:
    output = OutputDirectory(tmp_path / "out")
    with output as directory:
        output.save(write_text("saved"))
        with pytest.raises(OutputError, match="out: cannot be saved: No space left"):
            output.save(full_disk)
        assert contents(tmp_path / "out") == {SUMMARY: "saved"}
        (directory / SUMMARY).write_text("final")
    assert contents(tmp_path / "out") == {SUMMARY: "final"}


def test_results_are_written_elsewhere_if_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setenv("HOME", str(home))
    output = OutputDirectory(tmp_path / "disk" / "out")

    def write(place: Path) -> None:
        if place.parent != home:
            full_disk(place)
        write_text("final")(place)

    with pytest.raises(OutputError, match=r"No space left on device; the results are in .*home/out-.* instead"), output:
        output.finish(write)
    (other,) = home.iterdir()
    assert contents(other) == {SUMMARY: "final"}


def test_space_for_the_results_is_reserved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    output = OutputDirectory(tmp_path / "out", reserved=True)
    with output as directory:
        held = directory_size(directory)
        output.finish(lambda place: void((place / SUMMARY).write_text(f"{directory_size(place)}")))
    assert held == MIN_RESERVE
    assert contents(tmp_path / "out") == {SUMMARY: "0"}
    monkeypatch.setattr("os.posix_fallocate", full_disk)
    with pytest.raises(OutputError, match=r"out: \d+ MB are free there, and 16 MB are needed for the results"):
        OutputDirectory(tmp_path / "other" / "out", reserved=True).__enter__()
    assert not list((tmp_path / "other").iterdir())


def test_a_run_on_a_full_disk_answers(tmp_path: Path) -> None:
    """Answers have one size, whatever they say, and need no other file."""
    output = OutputDirectory(tmp_path / "out")
    with output as directory:
        assert running_process(tmp_path / "out") is None
        sizes = set()
        for problem in ("", "out: cannot be saved: No space left on device", "ü\n" * 1000, ""):
            output.announce(lambda before, text=problem: replace(before, saves=before.saves + 1, save_problem=text))
            control = running_process(tmp_path / "out")
            assert control is not None
            assert control.process == os.getpid()
            assert problem.startswith(control.save_problem)
            sizes.add(directory_size(directory))
        assert control.saves == 4
    assert len(sizes) == 1
    assert contents(tmp_path / "out") == {}
    assert running_process(tmp_path / "out") is None


def test_results_of_a_killed_run_are_recovered(tmp_path: Path) -> None:
    out = earlier_results(tmp_path, True)
    code = (
        "import os, pathlib, sys; from slam.io.output_dir import *; output = OutputDirectory(pathlib.Path(sys.argv[1]),"
        " True, reserved=True); work = output.__enter__(); (work / REVIEW).write_text('log')\n"
        "output.announce(lambda before: before)\n"
        "for text in ('saved', 'saved again'): output.save(lambda place: (place / SUMMARY).write_text(text))\n"
        "os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", code, out], check=False)
    assert contents(out) == {SUMMARY: "saved again"}
    (left,) = left_behind(out)
    with OutputDirectory(tmp_path / "out", overwrite=True):
        assert left_behind(out) == [left]  # not that of the run that goes on
    out = earlier_results(tmp_path, True)
    recover_results(out)
    assert contents(out) == {SUMMARY: "earlier", REVIEW: "log"}
    assert contents(tmp_path / "out-earlier-1") == {SUMMARY: "earlier"}
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["out", "out-earlier-1"]
    with pytest.raises(OutputError, match="no killed run has left anything beside it"):
        recover_results(out)


def test_a_run_killed_while_it_replaces_earlier_results_leaves_them(tmp_path: Path) -> None:
    code = (
        "import os, pathlib, sys; from slam.io import output_dir; exchange = output_dir.exchange_directories\n"
        "output_dir.exchange_directories = lambda *pair: (exchange(*pair), os.kill(os.getpid(), 9))\n"
        "output = output_dir.OutputDirectory(pathlib.Path(sys.argv[1]), True); output.__enter__()\n"
        "output.save(lambda place: (place / output_dir.SUMMARY).write_text('saved'))"
    )
    out = earlier_results(tmp_path, True)
    subprocess.run([sys.executable, "-c", code, out], check=False)
    assert contents(out) == {SUMMARY: "saved"}
    recover_results(out)
    assert contents(out) == {SUMMARY: "saved"}
    assert contents(tmp_path / "out-earlier-1") == {SUMMARY: "earlier"}


def test_results_are_on_the_disk_before_they_replace_others(
    tmp_path: Path, finished: Finished, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise a power failure after the end of a run leaves empty files in place of both."""
    synchronised, replaced = set(), []
    synchronise = os.fsync

    def note(descriptor: int) -> None:
        synchronised.add(os.fstat(descriptor).st_ino)
        synchronise(descriptor)

    def exchange(new: Path, target: Path) -> None:
        replaced.extend(entry.stat().st_ino for entry in [new, *new.rglob("*")])
        assert synchronised >= set(replaced)
        exchange_directories(new, target)

    monkeypatch.setattr("os.fsync", note)
    monkeypatch.setattr("slam.io.output_dir.exchange_directories", exchange)
    with OutputDirectory(earlier_results(tmp_path, True), overwrite=True) as directory:
        write_results(directory, finished, Config(), {})
    assert len(replaced) == 6
    assert tmp_path.stat().st_ino in synchronised


def earlier_results(folder: Path, present: bool) -> Path:
    out = folder / "out"
    if present:
        out.mkdir(exist_ok=True)
        (out / SUMMARY).write_text("earlier")
    return out


def full_disk(*_: object) -> None:
    raise OSError(28, "No space left on device")
