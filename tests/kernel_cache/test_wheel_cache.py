"""Compiled functions of a wheel are loaded on other computers too, and never if they are stale or do not suit it."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

import kernel_cache
from hatch_build import LEVELS

pytestmark = pytest.mark.slow

KERNEL = """
import numpy as np
from kernel_cache import compile_cached
from .constants import FACTOR

def total(values):
    result = 0.0
    for value in values:
        result += FACTOR * value
    return result

total = compile_cached(total, fastmath=True)
VALUES = np.random.default_rng(1).normal(size=1001)
"""

WRITE = """
import sys
from pathlib import Path
from kernel_cache.wheel import write_wheel_cache
from toy.kernel import VALUES, total

print(total(VALUES).hex(), write_wheel_cache(Path(sys.argv[1]), sys.argv[2:]))
"""

CALL = """
import sys
from numba.core.event import RecordingListener, install_listener
from kernel_cache import is_cached
from toy.kernel import VALUES, total

known = is_cached(total)
with install_listener("numba:compile", RecordingListener()) as listener:
    value = total(VALUES)
print(value.hex(), "compiled" if listener.buffer else "loaded", known)
"""

OTHER_TYPES = """
with install_listener("numba:compile", RecordingListener()) as listener:
    total(VALUES.astype("float32"))
print("compiled" if listener.buffer else "loaded")
"""

LEVEL, FEATURES = LEVELS[platform.machine()]
TARGET = {"NUMBA_CPU_NAME": LEVEL, "NUMBA_CPU_FEATURES": ",".join(f"+{feature}" for feature in FEATURES)}


class Installation:
    """Folder of installed packages with the package `toy`, whose function depends on a constant of another module."""

    def __init__(self, folder: Path) -> None:
        self.packages, self.cache = folder / "packages", folder / "cache"
        self.toy, self.compiled = self.packages / "toy", self.packages / "kernel_cache" / "compiled"
        self.toy.mkdir(parents=True)
        (self.toy / "__init__.py").touch()
        (self.toy / "constants.py").write_text("FACTOR = 2.0\n")
        (self.toy / "kernel.py").write_text(KERNEL)
        source = Path(kernel_cache.__file__).parent
        others = shutil.ignore_patterns("__pycache__", "compiled")
        shutil.copytree(source, self.packages / "kernel_cache", ignore=others)

    def run(self, program: str, arguments: Sequence[str] = (), **environment: str) -> list[str]:
        """Return the words that a program prints, with an empty cache of numba."""
        shutil.rmtree(self.cache, ignore_errors=True)
        variables = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")}
        variables |= {"NUMBA_CACHE_DIR": str(self.cache), **environment}
        command = [sys.executable, "-c", program, *arguments]
        answer = subprocess.run(command, cwd=self.packages, env=variables, capture_output=True, text=True, timeout=250)
        assert answer.returncode == 0, answer.stderr
        return answer.stdout.split()


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Return the compiled functions of a wheel, and what the function in it returns."""
    installation = Installation(tmp_path_factory.mktemp("built"))
    value, count = installation.run(WRITE, [str(installation.compiled), *FEATURES], **TARGET)
    assert count == "1"
    return installation.compiled, value


@pytest.fixture
def installed(built: tuple[Path, str], tmp_path: Path) -> Installation:
    installation = Installation(tmp_path)
    shutil.copytree(built[0], installation.compiled)
    return installation


def test_functions_of_the_wheel_are_loaded(installed: Installation, built: tuple[Path, str]) -> None:
    """With times of files and a folder that differ from those of the build, as in an installation.

    They are compiled for types of arguments with which the wheel has none.
    """
    os.utime(installed.toy / "kernel.py", (0.0, 0.0))
    before = contents(installed.compiled)
    assert installed.run(CALL + OTHER_TYPES) == [built[1], "loaded", "True", "compiled"]
    assert contents(installed.compiled) == before


def contents(folder: Path) -> dict[Path, bytes]:
    return {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def test_function_is_compiled_without_the_wheel(tmp_path: Path) -> None:
    assert Installation(tmp_path).run(CALL)[1:] == ["compiled", "False"]


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("constants.py", "FACTOR = 2.0", "FACTOR = 4.0"),
        ("kernel.py", "result += FACTOR * value", "result += 2.0 * FACTOR * value"),
    ],
)
def test_function_is_compiled_if_a_source_has_changed(
    installed: Installation, built: tuple[Path, str], file: str, old: str, new: str
) -> None:
    """The function itself, or a constant of another module that was compiled in."""
    source = installed.toy / file
    source.write_text(source.read_text().replace(old, new))
    value, way, known = installed.run(CALL)
    assert (way, known) == ("compiled", "False")
    assert float.fromhex(value) == pytest.approx(2.0 * float.fromhex(built[1]))


@pytest.mark.parametrize(
    ("variable", "value"),
    [("NUMBA_CPU_NAME", "generic"), ("NUMBA_CPU_FEATURES", "")],
)
@pytest.mark.skipif(not FEATURES, reason="every processor of this architecture has the features of the wheel")
def test_function_is_compiled_for_a_lesser_processor(installed: Installation, variable: str, value: str) -> None:
    assert installed.run(CALL, **{variable: value})[1:] == ["compiled", "False"]


def test_function_is_compiled_by_another_version_of_numba(installed: Installation) -> None:
    other = "import numba; numba.__version__ = '0.1'\n"
    assert installed.run(other + CALL)[1:] == ["compiled", "False"]
