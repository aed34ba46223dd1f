"""The wheel contains what it needs: types for users of the packages, worlds, the parts of the report page."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder

ROOT = Path(__file__).parents[1]

TYPED_USE = """
from drivers.messages import Scan
from features import Extractor, Noise
from slam import Slam

reveal_type(Slam().pose)
reveal_type(Extractor(Noise(0.01, 0.002)).extract)
reveal_type(Scan.duration)
Slam(config=1)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(
        next(WheelBuilder(str(ROOT)).build(directory=str(tmp_path_factory.mktemp("dist")), versions=["standard"]))
    )


def test_the_wheel_contains_types_worlds_and_page_parts(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {f"{package}/py.typed" for package in ("slam", "features", "drivers", "kernel_cache")} <= names
    worlds = {world.name for world in (ROOT / "datasets" / "worlds").glob("*.toml")}
    assert worlds == {Path(name).name for name in names if name.startswith("drivers/simulation/worlds/")}
    page = "slam/visualisation/report_page/"
    assert {f"{page}page.{suffix}" for suffix in ("html", "css", "js")} <= names


@pytest.mark.slow
def test_mypy_uses_the_types_of_an_installed_wheel(wheel: Path, tmp_path: Path) -> None:
    environment = tmp_path / "venv"
    venv.create(environment)
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(environment)}))
    zipfile.ZipFile(wheel).extractall(packages)
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    (tmp_path / "use.py").write_text(TYPED_USE)
    options = ["--strict", "--no-incremental", "--python-executable", str(environment / "bin" / "python")]
    command = [sys.executable, "-m", "mypy", *options, "use.py"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "py.typed" not in result.stdout
    assert "numpy.ndarray" in result.stdout
    errors = [line for line in result.stdout.splitlines() if "error:" in line]
    assert len(errors) == 1, result.stdout
    assert 'Argument "config" to "Slam" has incompatible type "int"' in errors[0]
