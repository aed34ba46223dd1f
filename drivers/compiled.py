"""Compile functions with numba, and cache the result on disk as long as no source changes on which it depends.

Numba compares the file of a cached function only, but it also compiles in constants and functions of other modules: if
those change, the cached function is wrong. Here the cached functions of a module are deleted if the module or any
module that it imports, directly or indirectly, has changed. Imports at module level are followed, within the packages
that are installed beside the module's own. All kernels of `slam` together take less than 10 ms for this.
"""

from __future__ import annotations

import hashlib
import inspect
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import ParamSpec, TypeVar

from numba import njit

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

IMPORT = re.compile(r"^(?:from +(\.*)([\w.]*) +import +(\([^)]*\)|.*)|import +([\w., ]+))", re.MULTILINE)
"""Import statement at module level, with the groups dots, module and names (`from`), or modules (`import`)."""


def _import_array_functions() -> None:
    """Import numba's functions of arrays without SciPy's linear algebra.

    Before the first compiled function runs, numba imports both to find out if there is BLAS. That takes a sixth of a
    second and 16 MB, and no function of this project calls it: products of small matrices are written out. A function
    of another program that calls BLAS imports it when it is compiled.
    """
    if "scipy.linalg" in sys.modules:
        return
    sys.modules["scipy.linalg"] = None  # type: ignore[assignment]  # an import of it fails
    try:
        with suppress(ImportError):  # another version of numba: it imports SciPy when it needs it
            from numba.np import arraymath

            arraymath._HAVE_BLAS = True  # it can be imported from now on
    finally:
        del sys.modules["scipy.linalg"]


_import_array_functions()


def compiled(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Compile a function at its first call, or load it from the cache on disk."""
    return _compiled(function, inline=False)


def inlined(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Compile a function that compiled functions call in inner loops, and put its code in place of each call.

    To pass arrays to a function takes as long as some dozens of operations. LLVM itself inlines only the smallest ones.
    """
    return _compiled(function, inline=True)


def is_cached(function: Callable[..., object]) -> bool:
    """Return True if a compiled function need not be compiled any more: it is on disk, for any types of arguments."""
    stats = getattr(function, "stats", None)  # None if NUMBA_DISABLE_JIT is set
    module = Path(inspect.getfile(inspect.unwrap(function))).stem
    return stats is None or any(Path(stats.cache_path).glob(f"{module}.{function.__name__}-*.nbi"))


def _compiled(function: Callable[Arguments, Result], *, inline: bool) -> Callable[Arguments, Result]:
    dispatcher: Callable[Arguments, Result] = njit(cache=True, forceinline=inline)(function)
    stats = getattr(dispatcher, "stats", None)  # None if NUMBA_DISABLE_JIT is set
    if stats is not None:
        discard_stale(Path(inspect.getfile(function)), Path(stats.cache_path))
    return dispatcher


@cache
def discard_stale(module: Path, folder: Path) -> None:
    """Delete a module's compiled functions in the cache `folder` if it, or a module it imports, has changed.

    Without write access nothing is deleted: such a package is not being edited.
    """
    digest = hashlib.sha256()
    for source in dependencies(module):
        digest.update(_read(source, _version(source))[0])
    mark = folder / f"{module.stem}.sources-{digest.hexdigest()[:16]}"
    if mark.exists():
        return
    with suppress(OSError):
        for pattern in ("sources-*", "*.nbi", "*.nbc"):
            for old in folder.glob(f"{module.stem}.{pattern}"):
                old.unlink(missing_ok=True)
        folder.mkdir(parents=True, exist_ok=True)
        mark.touch()


def dependencies(module: Path) -> list[Path]:
    """Return a module and all modules that it imports, directly or not, sorted; other packages are not followed."""
    found, waiting = set[Path](), [module]
    while waiting:
        source = waiting.pop()
        if source not in found:
            found.add(source)
            waiting.extend(_read(source, _version(source))[1])
    return sorted(found)


def _version(source: Path) -> tuple[int, int]:
    """Return time of change and size of a source."""
    status = source.stat()
    return status.st_mtime_ns, status.st_size


@cache
def _read(source: Path, version: tuple[int, int]) -> tuple[bytes, tuple[Path, ...]]:
    """Return the hash of a version of a source, and the sources that it imports."""
    text = source.read_bytes()
    return hashlib.sha256(text).digest(), tuple(_imported(source, text.decode()))


def _imported(source: Path, text: str) -> Iterator[Path]:
    """Yield the sources that a source imports."""
    root = _root(source.parent)
    for dots, name, names, modules in IMPORT.findall(text):
        base = source.parents[len(dots) - 1] if dots else root
        for module in re.findall(r"[\w.]+", modules) or [name]:
            target = base.joinpath(*module.split(".")) if module else base
            if dots or _is_package(root / module.partition(".")[0]):
                yield from _sources(target, names)


def _sources(target: Path, names: str) -> Iterator[Path]:
    """Yield the source of a module or package, and those of a package's modules with the given names."""
    if not _is_package(target):
        if target.with_suffix(".py").exists():
            yield target.with_suffix(".py")
        return
    yield target / "__init__.py"
    for name in re.findall(r"\w+", names):
        if _is_package(target / name):
            yield target / name / "__init__.py"
        elif (target / f"{name}.py").exists():
            yield target / f"{name}.py"


@cache
def _is_package(folder: Path) -> bool:
    return (folder / "__init__.py").exists()


@cache
def _root(package: Path) -> Path:
    """Return the folder that contains the top-level package."""
    return _root(package.parent) if _is_package(package) else package
