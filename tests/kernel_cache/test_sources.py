"""Cached compiled functions are deleted if a module on which they depend changes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from kernel_cache.sources import PACKAGES, dependencies, discard_stale

ROOT = Path(__file__).parents[2]
KERNEL = """
from kernel_cache import compile_cached
from ..constants import FACTOR

@compile_cached
def scale(x):
    return FACTOR * x
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Create a package `toy` with a kernel in the sub-package `inner` that uses a constant of another module."""
    (tmp_path / "toy" / "inner").mkdir(parents=True)
    for folder in ("toy", "toy/inner"):
        (tmp_path / folder / "__init__.py").touch()
    (tmp_path / "other").mkdir()  # installed beside it, but not of this project
    (tmp_path / "other" / "__init__.py").touch()
    (tmp_path / "toy" / "constants.py").write_text("FACTOR = 2.0\n")
    (tmp_path / "toy" / "inner" / "kernel.py").write_text(KERNEL)
    return tmp_path / "toy"


@pytest.mark.slow
def test_cached_kernel_uses_the_changed_constant_of_another_module(package: Path) -> None:
    def run() -> str:
        code = "from toy.inner.kernel import scale; print(scale(1.0), sum(scale.stats.cache_hits.values()))"
        path = os.pathsep.join([str(package.parent), str(ROOT)])
        environment = {**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(package.parent / "cache")}
        return subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True).stdout

    assert run() == "2.0 0\n"
    assert run() == "2.0 1\n"
    (package / "constants.py").write_text("FACTOR = 3.0\n")
    assert run() == "3.0 0\n"


def test_only_the_caches_of_dependent_modules_are_deleted(package: Path, tmp_path: Path) -> None:
    kernel, cache = package / "inner" / "kernel.py", tmp_path / "cache"
    other = package / "other.py"
    other.write_text("import math\n")
    for module in (kernel, other):
        discard_stale(module, cache)
    files = [cache / "kernel.scale-5.py311.nbi", cache / "kernel.scale-5.py311.1.nbc", cache / "other.f-1.py311.nbi"]
    for file in files:
        file.touch()
    (package / "constants.py").write_text("FACTOR = 3.25\n")
    discard_stale.cache_clear()
    for module in (kernel, other):
        discard_stale(module, cache)
    assert [file.exists() for file in files] == [False, False, True]


def test_read_only_cache_is_not_changed(package: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    cache.write_text(text := "a file instead of the folder, so that nothing can be written in it")
    before = sorted(tmp_path.rglob("*"))
    discard_stale(package / "inner" / "kernel.py", cache)
    assert sorted(tmp_path.rglob("*")) == before
    assert cache.read_text() == text


@pytest.mark.parametrize(
    ("statement", "expected"),
    [
        ("from . import constants", {"constants.py", "__init__.py"}),
        ("from .constants import (\n    FACTOR,\n)", {"constants.py"}),
        ("import toy.constants", {"constants.py"}),
        ("from toy import constants", {"constants.py", "__init__.py"}),
        ("from .inner import kernel", {"inner/__init__.py", "inner/kernel.py", "constants.py"}),
        ("import numpy as np", set()),
        ("import other", set()),
        ("    from .constants import FACTOR", set()),
    ],
)
def test_dependencies_are_the_imported_modules(package: Path, statement: str, expected: set[str]) -> None:
    module = package / "module.py"
    module.write_text(f"{statement}\n")
    found = {file.relative_to(package.parent).as_posix() for file in dependencies(module)}
    assert found == {f"toy/{name}" for name in expected | {"module.py"}}


def test_caching_is_enabled_in_one_place() -> None:
    """By itself numba would leave stale functions in the cache."""
    sources = [source for package in PACKAGES for source in (ROOT / package).rglob("*.py")]
    enabling = {"cache=True", "enable_caching"}
    caching = {s.relative_to(ROOT).as_posix() for s in sources if any(word in s.read_text() for word in enabling)}
    assert caching == {"kernel_cache/functions.py"}
