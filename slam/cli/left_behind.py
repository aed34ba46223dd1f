"""Telling the user what killed runs left beside an output directory."""

from __future__ import annotations

from pathlib import Path

from ..io.work_directory import left_behind
from .console import print_message


def print_left_behind(out: Path) -> None:
    """Print a line for each directory that a killed run with the output directory `out` left behind."""
    for folder in left_behind(out):
        print_message(f"a killed run left {folder} behind; complete {out} with its files: wclm recover {out}")
