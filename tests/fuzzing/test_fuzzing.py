"""Damaged files are read, or refused with an error of one line: some of each kind; `make fuzz` reads more."""

from __future__ import annotations

from pathlib import Path

import pytest

from .kinds import Kind, make_kinds
from .worker import failure_of

INPUTS = 4


@pytest.fixture(scope="module")
def kinds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Kind]:
    return make_kinds(tmp_path_factory.mktemp("fuzzing"))


def test_damaged_files_are_refused_with_one_line(kinds: dict[str, Kind]) -> None:
    failed = {}
    for name, kind in kinds.items():
        intact = kind.file.read_bytes()
        kind.read(kind.path)
        for number in range(INPUTS):
            if failure := failure_of(kind, intact, number):
                failed[name, number] = failure
    assert not failed


def fail(path: Path) -> None:
    raise KeyError("a bug")


def test_other_errors_are_failures(tmp_path: Path) -> None:
    file = tmp_path / "a"
    file.write_bytes(b"intact")
    kind = Kind(file, file, lambda data, _: data + b"!", fail)
    assert "KeyError: 'a bug'" in failure_of(kind, b"intact", 0)
    assert file.read_bytes() == b"intact"
