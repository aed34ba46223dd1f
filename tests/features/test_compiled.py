"""Compiled functions on disk do not outlive the sources that they were compiled from."""

from __future__ import annotations

from pathlib import Path

from features.compiled import discard_stale


def test_a_changed_source_discards_what_was_compiled(tmp_path: Path) -> None:
    (tmp_path / "one.py").write_text("a = 1\n")
    cache = tmp_path / "__pycache__"
    cache.mkdir()
    kept, dropped = cache / "one.cpython.pyc", cache / "one.f.nbc"
    kept.touch()
    discard_stale(tmp_path)
    dropped.touch()
    discard_stale(tmp_path)
    assert dropped.exists()
    (tmp_path / "one.py").write_text("a = 123\n")
    discard_stale(tmp_path)
    assert kept.exists()
    assert not dropped.exists()


def test_a_read_only_package_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "one.py").write_text("a = 1\n")
    (tmp_path / "__pycache__").write_text("not a directory, so that nothing can be written in it")
    discard_stale(tmp_path)
