"""Sources on which a compiled function depends.

Numba compares the file of a cached function only, but it also compiles in constants and functions of other modules: if
those change, the cached function is wrong. Here a function depends on its module and on all modules that this one
imports, directly or indirectly. Imports at module level are followed, within the packages of this project. The compiled
functions that a run calls take some 20 ms for this, with paths as strings: objects of `Path` would take twice as long.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

PACKAGES = frozenset({"drivers", "features", "kernel_cache", "slam"})
"""Packages whose modules are followed besides those of the function's own package."""

IMPORT = re.compile(r"^(?:from +(\.*)([\w.]*) +import +(\([^)]*\)|.*)|import +([\w., ]+))", re.MULTILINE)
"""Import statement at module level, with the groups dots, module and names (`from`), or modules (`import`)."""


@cache
def discard_stale(module: Path, folder: Path) -> None:
    """Delete a module's compiled functions in the cache `folder` if it, or a module it imports, has changed.

    Without write access nothing is deleted: such a package is not being edited.
    """
    mark = folder / f"{module.stem}.sources-{digest_of(module)[:16]}"
    if mark.exists():
        return
    with suppress(OSError):
        for pattern in ("sources-*", "*.nbi", "*.nbc"):
            for old in folder.glob(f"{module.stem}.{pattern}"):
                old.unlink(missing_ok=True)
        folder.mkdir(parents=True, exist_ok=True)
        mark.touch()


def digest_of(module: Path) -> str:
    """Return a hash of the text of a module and of all modules that it imports, in hexadecimal digits."""
    digest = hashlib.sha256()
    for source in _dependencies(str(module)):
        digest.update(_read(source, _version(source))[0])
    return digest.hexdigest()


def path_in_package(module: Path) -> Path:
    """Return the path of a module relative to the folder that contains its top-level package."""
    return module.relative_to(_root(str(module.parent)))


def dependencies(module: Path) -> list[Path]:
    """Return a module and all modules that it imports, directly or not, sorted; other packages are not followed."""
    return [Path(source) for source in _dependencies(str(module))]


def _dependencies(module: str) -> list[str]:
    found, waiting = set[str](), [module]
    while waiting:
        source = waiting.pop()
        if source not in found:
            found.add(source)
            waiting.extend(_read(source, _version(source))[1])
    return sorted(found)


def _version(source: str) -> tuple[int, int]:
    """Return time of change and size of a source."""
    status = os.stat(source)
    return status.st_mtime_ns, status.st_size


@cache
def _read(source: str, version: tuple[int, int]) -> tuple[bytes, tuple[str, ...]]:
    """Return the hash of a version of a source, and the sources that it imports."""
    with open(source, "rb") as file:
        text = file.read()
    return hashlib.sha256(text).digest(), tuple(_imported(source, text.decode()))


def _imported(source: str, text: str) -> Iterator[str]:
    """Yield the sources that a source imports."""
    folder = os.path.dirname(source)
    root = _root(folder)
    followed = PACKAGES | {source[len(root) + 1 :].split(os.sep)[0]}
    for dots, name, names, modules in IMPORT.findall(text):
        base = os.path.join(folder, *[os.pardir] * (len(dots) - 1)) if dots else root
        for module in re.findall(r"[\w.]+", modules) or [name]:
            if dots or module.partition(".")[0] in followed:
                yield from _sources(os.path.normpath(os.path.join(base, *module.split("."))), names)


def _sources(target: str, names: str) -> Iterator[str]:
    """Yield the source of a module or package, and those of a package's modules with the given names."""
    if not _is_package(target):
        if _exists(f"{target}.py"):
            yield f"{target}.py"
        return
    yield os.path.join(target, "__init__.py")
    for name in re.findall(r"\w+", names):
        module = os.path.join(target, name)
        if _is_package(module):
            yield os.path.join(module, "__init__.py")
        elif _exists(f"{module}.py"):
            yield f"{module}.py"


@cache
def _exists(source: str) -> bool:
    return os.path.exists(source)


@cache
def _is_package(folder: str) -> bool:
    return os.path.exists(os.path.join(folder, "__init__.py"))


@cache
def _root(package: str) -> str:
    """Return the folder that contains the top-level package."""
    return _root(os.path.dirname(package)) if _is_package(package) else package
