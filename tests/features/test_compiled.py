"""Cached compiled functions of `features` are deleted if a source changes."""

from __future__ import annotations

from pathlib import Path

import pytest

from features.compiled import discard_stale


@pytest.mark.parametrize("folder", [".", "sub"])
def test_changed_source_deletes_cached_functions(tmp_path: Path, folder: str) -> None:
    (tmp_path / folder).mkdir(exist_ok=True)
    (tmp_path / folder / "one.py").write_text("a = 1\n")
    cache = tmp_path / folder / "__pycache__"
    cache.mkdir()
    bytecode, compiled = cache / "one.cpython.pyc", cache / "one.f.nbc"
    bytecode.touch()
    discard_stale(tmp_path)
    compiled.touch()
    discard_stale(tmp_path)
    assert compiled.exists()
    (tmp_path / folder / "one.py").write_text("a = 123\n")
    discard_stale(tmp_path)
    assert bytecode.exists()
    assert not compiled.exists()


def test_read_only_package_is_not_changed(tmp_path: Path) -> None:
    (tmp_path / "one.py").write_text("a = 1\n")
    cache = tmp_path / "__pycache__"
    cache.write_text(text := "a file instead of the folder, so that nothing can be written in it")
    before = sorted(tmp_path.rglob("*"))
    discard_stale(tmp_path)
    assert sorted(tmp_path.rglob("*")) == before
    assert cache.read_text() == text
