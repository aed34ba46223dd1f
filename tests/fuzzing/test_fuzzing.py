"""Damaged files are read, or refused with an error of one line: some of each kind; `make fuzz` reads more."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.errors import SlamError

from .kinds import Kind, make_kinds
from .worker import failure_of

INPUTS = 4


@pytest.fixture(scope="module")
def kinds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Kind]:
    return make_kinds(tmp_path_factory.mktemp("fuzzing"))


@pytest.mark.parametrize("number", [0, *(pytest.param(number, marks=pytest.mark.slow) for number in range(1, INPUTS))])
def test_damaged_files_are_refused_with_one_line(kinds: dict[str, Kind], number: int) -> None:
    failed = {}
    for path, read in {(kind.path, kind.read) for kind in kinds.values()}:
        read(path)
    for name, kind in kinds.items():
        intact = kind.file.read_bytes()
        if failure := failure_of(kind, intact, number):
            failed[name] = failure
    assert not failed


def fail(path: Path) -> None:
    raise KeyError("a bug")


def read_beyond_an_array(path: Path) -> None:
    try:
        raise IndexError("index is out of bounds")  # as numba does
    except IndexError as error:
        raise SlamError(f"{path}: cannot be read") from error


@pytest.mark.parametrize(
    ("read", "failure"), [(fail, "KeyError: 'a bug'"), (read_beyond_an_array, "a compiled function reads beyond")]
)
def test_other_errors_are_failures(tmp_path: Path, read: Callable[[Path], None], failure: str) -> None:
    file = tmp_path / "a"
    file.write_bytes(b"intact")
    kind = Kind(file, file, lambda data, _: data + b"!", read)
    assert failure in failure_of(kind, b"intact", 0)
    assert file.read_bytes() == b"intact"
