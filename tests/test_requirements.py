"""The locked requirements install with pip as old as that of Debian 12 (23.0)."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

LOCK = Path(__file__).parents[1] / "requirements.lock"


def locked() -> dict[str, set[str]]:
    """Return the extras of each locked package, by its name."""
    lines = re.findall(r"^(\S+?)==\S+", LOCK.read_text(encoding="utf-8"), re.MULTILINE)
    requirements = [Requirement(line) for line in lines]
    return {canonicalize_name(one.name): {canonicalize_name(extra) for extra in one.extras} for one in requirements}


def requirements_of(name: str, extras: set[str]) -> Iterator[Requirement]:
    """Yield what an installed package requires here with some extras; nothing if it is not installed."""
    try:
        requires = distribution(name).requires or ()
    except PackageNotFoundError:
        return  # for other platforms or versions of Python
    for requirement in map(Requirement, requires):
        marker = requirement.marker
        if marker is None or any(marker.evaluate({"extra": extra}) for extra in extras | {""}):
            yield requirement


def test_extras_that_locked_packages_require_are_locked() -> None:
    """Old pip takes `coverage[toml]>=7` for unpinned beside `coverage==7.1`, and fails once there is a newer one."""
    pinned = locked()
    assert "coverage" in pinned
    missing = {
        f"{name} requires {requirement.name}[{','.join(sorted(requirement.extras))}]"
        for name, extras in pinned.items()
        for requirement in requirements_of(name, extras)
        if not {canonicalize_name(extra) for extra in requirement.extras} <= pinned[canonicalize_name(requirement.name)]
    }
    assert not missing


def test_locked_packages_require_nothing_that_is_not_locked() -> None:
    pinned = locked()
    missing = {
        f"{name} requires {requirement.name}"
        for name, extras in pinned.items()
        for requirement in requirements_of(name, extras)
        if canonicalize_name(requirement.name) not in pinned
    }
    assert not missing
