"""Wheel and source distribution install into an empty environment, and `wclm demo` runs from them."""

from __future__ import annotations

import os
import subprocess
import tarfile
import venv
from pathlib import Path

import pytest
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
BUILDERS = {"wheel": WheelBuilder, "sdist": SdistBuilder}
UNREACHABLE = ("NewConnectionError", "Connection refused", "Temporary failure in name resolution", "Network is unreach")
"""Parts of pip's messages if there is no package index."""


def build(kind: str, directory: Path) -> Path:
    return Path(next(BUILDERS[kind](str(ROOT)).build(directory=str(directory), versions=["standard"])))


def run(command: list[str | Path], directory: Path) -> subprocess.CompletedProcess[str]:
    """Run a command that sees neither this repository nor the display."""
    hidden = ("PYTHONPATH", "VIRTUAL_ENV", "DISPLAY", "WAYLAND_DISPLAY")
    environment = {name: value for name, value in os.environ.items() if name not in hidden}
    return subprocess.run(command, cwd=directory, env=environment, capture_output=True, text=True, check=False)


def test_the_source_distribution_contains_what_is_built_and_tested(tmp_path: Path) -> None:
    archive = build("sdist", tmp_path)
    with tarfile.open(archive) as contents:
        names = {name.partition("/")[2] for name in contents.getnames()}
    assert {"pyproject.toml", "README.md", "LICENSE", "slam/__init__.py", "tests/test_installation.py"} <= names
    assert any(name.startswith("datasets/worlds/") for name in names)
    assert not any(name.startswith((".venv", ".git/", "demo/", "site/")) for name in names)


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("kind", BUILDERS)
def test_the_demo_runs_from_an_empty_environment(kind: str, tmp_path: Path) -> None:
    package = build(kind, tmp_path / "dist")
    environment = tmp_path / "venv"
    venv.create(environment, with_pip=True)
    installed = run([environment / "bin" / "pip", "install", "--quiet", f"{package}[plots]"], tmp_path)
    if installed.returncode and any(text in installed.stderr for text in UNREACHABLE):
        pytest.skip("no package index can be reached")
    assert installed.returncode == 0, installed.stderr
    checked = run([environment / "bin" / "pip", "check"], tmp_path)
    assert checked.returncode == 0, checked.stdout
    demo = run([environment / "bin" / "wclm", "demo"], tmp_path)
    assert demo.returncode == 0, demo.stderr
    assert "1 loop closed" in demo.stdout
    for name in ("closure.png", "map.png", "report.html", "review.rrd"):
        assert (tmp_path / "demo" / name).stat().st_size > 10_000
    place = run([environment / "bin" / "python", "-c", "import slam; print(slam.__file__)"], tmp_path)
    assert place.stdout.startswith(str(environment))
