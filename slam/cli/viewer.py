"""The Rerun viewer, started for or named to the user."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from ..io.output_dir import REVIEW
from .console import print_message

LOCAL_ONLY = ("--bind", "127.0.0.1")  # viewers listen, too, and everywhere unless told


def viewer_command(out: Path) -> list[str]:
    """The command that opens the review log in `out`."""
    return [_viewer(), *LOCAL_ONLY, str(out / REVIEW)]


def connect_command(url: str) -> list[str]:
    """The command that looks on at a live run's server."""
    return [_viewer(), *LOCAL_ONLY, "--connect", url]


def _viewer() -> str:
    """The viewer on the path, else this environment's."""
    program = "rerun"
    if shutil.which(program) is None:
        beside = Path(sys.executable).with_name(program)
        program = os.path.relpath(beside) if beside.is_relative_to(Path.cwd()) else str(beside)
    return program


def has_display() -> bool:
    """Whether a window could be opened."""
    return sys.platform == "darwin" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def open_viewer(command: list[str]) -> None:
    """Start the viewer and let it live on; that it cannot be started is no failure of the demo."""
    try:
        subprocess.Popen(
            command,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError as error:
        print_message(f"the viewer cannot be started: {error}")
