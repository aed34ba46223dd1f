"""A command loads what it needs, when it needs it: start-up is most of the time that a short recording takes."""

import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import drivers
import features
import slam
from slam.cli.app import app, leave_out_others
from slam.cli.compilation import compile_for_recording

RUN = """
import sys

HEAVY = {
    *("scipy.linalg", "scipy.stats", "scipy.optimize", "scipy.ndimage", "scipy.spatial", "pyarrow.compute"),
    *("pandas", "matplotlib", "rosbags", "mcap", "rerun", "coverage"),
} - set(sys.modules)  # those that measure the tests

import slam.cli
import slam.pipeline

def loaded():
    return sorted((HEAVY | {"drivers.simulation", "pyarrow"}) & set(sys.modules))

class Slam(slam.pipeline.Slam):
    def finish(self):
        print("before the end:", loaded(), file=sys.stderr)
        return super().finish()

slam.pipeline.Slam = Slam
sys.argv = ["wclm", "run", RECORDING, "--out", OUT, "--no-review"]
try:
    slam.cli.main()
finally:
    print("at the end:", loaded(), file=sys.stderr)
"""


def write_log(path: Path) -> None:
    """Write a drive of 2 m through a room of 8 m by 6 m as a CARMEN log."""
    angles = np.radians(np.arange(-90, 90))
    lines = []
    for k, x in enumerate(np.arange(-1.0, 1.0, 0.05).tolist()):
        ranges = np.minimum((4.0 - x) / np.cos(angles).clip(1e-9), 3.0 / np.abs(np.sin(angles)).clip(1e-9))
        values = " ".join(f"{value:.3f}" for value in ranges)
        lines.append(f"FLASER {len(angles)} {values} {x:.4f} 0 0 {x:.4f} 0 0 {0.1 * k:.3f} host 0.1\n")
    path.write_text("".join(lines))


def test_the_help_is_printed_without_numpy_and_pydantic() -> None:
    code = "import sys\nimport slam.cli.app\nprint({'numpy', 'pydantic'} & set(sys.modules) or 'none')"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=250)
    assert (answer.stdout, answer.stderr) == ("none\n", "")


@pytest.mark.parametrize("package", [features, drivers, slam], ids=lambda package: package.__name__)
def test_every_public_name_is_found_when_it_is_used(package: ModuleType) -> None:
    assert all(hasattr(package, name) for name in package.__all__)


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """Output directory of a run of a log in a process of its own, and what the process printed on stderr."""
    compile_for_recording()  # the first time, the warm-up would map a drive in the process before the recording
    folder = tmp_path_factory.mktemp("startup")
    log, out = folder / "log.clf", folder / "out"
    write_log(log)
    constants = f"RECORDING, OUT = {str(log)!r}, {str(out)!r}\n"
    answer = subprocess.run([sys.executable, "-c", constants + RUN], capture_output=True, text=True, timeout=250)
    assert answer.returncode == 0, answer.stderr
    return out, [line for line in answer.stderr.splitlines() if not line.startswith("wclm: compiling")]


@pytest.mark.slow
def test_a_run_of_a_log_loads_no_library_of_other_formats_and_tables_at_the_end(mapped: tuple[Path, list[str]]) -> None:
    assert mapped[1] == ["before the end: []", "at the end: ['pyarrow']"]


@pytest.mark.slow
def test_the_review_log_is_written_without_scipy(mapped: tuple[Path, list[str]], tmp_path: Path) -> None:
    """The code of Rerun is returned to the system as well, once it is imported."""
    recording = mapped[0].parent / "log.clf"
    code = (
        f"import sys; sys.argv = ['wclm', 'run', {str(recording)!r}, '--out', {str(tmp_path / 'out')!r}]\n"
        "before = set(sys.modules)  # what measures the tests\nimport slam.cli, slam.cli.slam_run\n"
        "returned = []\n"
        "slam.cli.slam_run.return_code_of_imports = lambda: returned.append('rerun' in sys.modules)\n"
        "try: slam.cli.main()\nexcept SystemExit as end: assert not end.code\n"
        "print(sorted({'scipy.special'} & set(sys.modules) - before), returned, file=sys.stderr)"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=250)
    assert answer.stderr.splitlines()[-1] == "[] [False, True]"
    assert (tmp_path / "out" / "review.rrd").stat().st_size > 0


@pytest.mark.slow
@pytest.mark.parametrize("command", [["report", "--overwrite"], ["map", "--format", "svg"]])
def test_reports_and_drawings_are_made_without_the_estimator(
    mapped: tuple[Path, list[str]], command: list[str]
) -> None:
    name, *options = command
    code = (
        f"import sys; sys.argv = ['wclm', {name!r}, {str(mapped[0])!r}, *{options!r}]\nimport slam.cli\n"
        "try: slam.cli.main()\nexcept SystemExit as end: assert not end.code\n"
        "print(sorted({'gtsam', 'numba', 'scipy', 'pyarrow'} & set(sys.modules)), file=sys.stderr)"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=250)
    assert answer.stderr.strip() == "[]"


@pytest.mark.parametrize(
    ("arguments", "kept"),
    [(["run", "drive.mcap"], {"run"}), (["bench", "slam"], {"bench"}), (["rnu"], None), (["--help"], None), ([], None)],
)
def test_only_the_called_command_is_set_up(
    arguments: list[str], kept: set[str] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(app, "registered_commands", app.registered_commands)  # restored afterwards
    monkeypatch.setattr(app, "registered_groups", app.registered_groups)
    names = {entry.name for entry in [*app.registered_commands, *app.registered_groups]}
    leave_out_others(arguments)
    assert {entry.name for entry in [*app.registered_commands, *app.registered_groups]} == (kept or names)
