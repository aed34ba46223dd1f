"""The command line detects other packages named `drivers` or `features`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import drivers
from slam.cli.import_check import find_import_error

ROOT = Path(drivers.__file__).parents[1]


def start(directory: Path) -> subprocess.CompletedProcess[str]:
    """Run `wclm --version` in a directory, from which Python imports first."""
    return subprocess.run(
        [sys.executable, "-c", "from slam.cli import main; main()", "--version"],
        cwd=directory,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(["", str(ROOT)])},
        capture_output=True,
        text=True,
        timeout=250,
    )


@pytest.mark.slow
def test_our_own_packages_are_accepted(tmp_path: Path) -> None:
    assert find_import_error() is None
    answer = start(tmp_path)
    assert (answer.returncode, answer.stderr) == (0, "")


@pytest.mark.parametrize("name", ["drivers", pytest.param("features", marks=pytest.mark.slow)])
@pytest.mark.parametrize("module", ["{}/__init__.py", pytest.param("{}.py", marks=pytest.mark.slow)])
def test_another_package_of_the_same_name_is_a_one_line_error(tmp_path: Path, name: str, module: str) -> None:
    other = tmp_path / module.format(name)
    other.parent.mkdir(exist_ok=True)
    other.write_text("raise AssertionError('imported')\n")
    answer = start(tmp_path)
    assert answer.returncode == 2
    assert answer.stdout == ""
    (line,) = answer.stderr.splitlines()
    assert line.startswith(f"wclm: {other}: is imported as `{name}` instead of {ROOT / name / '__init__.py'}; ")


def test_a_folder_without_a_package_is_ignored(tmp_path: Path) -> None:
    (tmp_path / "drivers").mkdir()
    (tmp_path / "drivers" / "notes.txt").write_text("no package")
    assert start(tmp_path).returncode == 0
