"""Commands succeed with damaged files, or refuse them with one line: some of each file; `sweeps` runs more."""

from __future__ import annotations

from pathlib import Path

import pytest

from .sweeps import SWEEPS, Sweep, failures, make_files

pytestmark = pytest.mark.slow

STEP = 4001
"""Each so many commands of a sweep."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sweeps")
    make_files(folder)
    return folder


@pytest.mark.parametrize("sweep", SWEEPS, ids=lambda sweep: sweep.file)
def test_a_command_on_a_damaged_file_succeeds_or_refuses_it_with_one_line(
    folder: Path, sweep: Sweep, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    assert list(failures(folder, sweep, STEP)) == []
