"""Completion of an output directory with what a killed run left beside it."""

from __future__ import annotations

import shutil
from pathlib import Path

from ..errors import OutputError
from .output_dir import REVIEW, SUMMARY
from .work_directory import CONTROL, RESERVE, left_behind, sibling_directories


def recover_results(target: Path) -> list[str]:
    """Complete `target` with what killed runs left beside it; return a line for each thing done.

    The review log is moved to the last saved state of the run, or becomes the only result if nothing was saved. Earlier
    results that the killed run was about to replace are restored if there are no others, else named. Nothing but
    temporary files is deleted. Raises OutputError if nothing was left, or if files cannot be moved.
    """
    folders = left_behind(target)
    if not folders:
        raise OutputError(f"{target}: no killed run has left anything beside it")
    try:
        return [line for folder in folders for line in _recover(target, folder)]
    except OSError as error:
        raise OutputError(f"{target}: cannot be recovered: {error.strerror or error}") from error


def _recover(target: Path, folder: Path) -> list[str]:
    lines = []
    for name in (RESERVE, CONTROL):
        (folder / name).unlink(missing_ok=True)
    saved, old = sibling_directories(folder)
    shutil.rmtree(saved, ignore_errors=True)  # incomplete, or replaced by the target
    if old.is_dir() and not old.is_symlink():
        place = target if not target.exists() else _free_name(target, "earlier")
        old.rename(place)
        lines.append(f"{place}: results of the run before")
    parts = sorted(folder.iterdir())
    if parts and not target.exists():
        folder.rename(target)
        return [*lines, f"{target}: {', '.join(part.name for part in parts)}; no map had been saved yet"]
    if parts and ((target / REVIEW).exists() or (folder / SUMMARY).exists()):
        place = _free_name(target, "killed")
        folder.rename(place)
        return [*lines, f"{place}: {', '.join(part.name for part in parts)}"]
    for part in parts:
        part.rename(target / part.name)
        lines.append(f"{target}: {part.name}")
    folder.rmdir()
    return lines or [f"{folder}: was empty and is removed"]


def _free_name(target: Path, word: str) -> Path:
    """Return a path beside `target` that does not exist."""
    number = 1
    while (path := target.with_name(f"{target.name}-{word}-{number}")).exists():
        number += 1
    return path
