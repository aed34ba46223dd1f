"""A wheel with compiled functions maps a drive at once in an empty environment, and gives the same trajectory."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

from hatch_build import LEVELS

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]
ROOT = Path(__file__).parents[1]

RUN = """
import sys
from numba.core.event import RecordingListener, install_listener

sys.argv = ["wclm", "run", "sim:room?duration=10&seed=1", "--out", sys.argv[1]]
from slam.cli import main

with install_listener("numba:compile", RecordingListener()) as listener:
    try:
        main()
    finally:
        print("compiled:", len(listener.buffer) // 2)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, env={**os.environ, "WCLM_COMPILED": "1"}, check=True)
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the wheel beside the libraries of the tests, as pip does, where nothing can be written later."""
    environment = tmp_path_factory.mktemp("venv")
    venv.create(environment, with_pip=False)
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(environment)}))
    zipfile.ZipFile(wheel).extractall(packages)
    (packages / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return environment


def run(python: Path, home: Path, **variables: str) -> tuple[str, bytes]:
    """Map a drive with an empty home folder; return the number of compilations, and the trajectory."""
    home.mkdir()
    variables["NUMBA_CACHE_DIR"] = str(home / "cache")  # as if the packages could not be written to; root can
    kept = {key: value for key, value in os.environ.items() if not key.startswith(("NUMBA_", "PYTHON"))}
    command = [str(python), "-c", RUN, str(home / "map")]
    answer = subprocess.run(
        command, cwd=home, env=kept | {"HOME": str(home)} | variables, capture_output=True, text=True
    )
    assert answer.returncode == 0, answer.stderr
    return answer.stdout.splitlines()[-1], (home / "map" / "trajectory.tum").read_bytes()


def test_wheel_is_for_this_platform_and_version_of_numba(wheel: Path) -> None:
    import numba

    archive = zipfile.ZipFile(wheel)
    metadata = next(name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
    assert f"Requires-Dist: numba=={numba.__version__}\n" in archive.read(metadata).decode()
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    assert wheel.stem.endswith(f"-{python}-{python}-manylinux_2_28_{platform.machine()}")


def test_first_run_compiles_nothing_and_changes_no_trajectory(environment: Path, tmp_path: Path) -> None:
    """Compiled here for the processor that the wheel is for: sums for another one may have another order."""
    level, features = LEVELS[platform.machine()]
    target = {"NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": ",".join(f"+{feature}" for feature in features)}
    loaded = run(environment / "bin" / "python", tmp_path / "loaded")
    compiled = run(environment / "bin" / "python", tmp_path / "compiled", **target)
    assert loaded[0] == "compiled: 0"
    assert compiled[0] != "compiled: 0"
    assert loaded[1] == compiled[1]
    assert list((tmp_path / "compiled").rglob("*.nbc"))
    assert not list((tmp_path / "loaded").rglob("*.nbc"))
