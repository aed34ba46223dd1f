"""Commands that start the Rerun viewer."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from .console import print_message

LOCAL_ONLY = ("--bind", "127.0.0.1")
"""Options for the viewer, which otherwise accepts connections on all interfaces."""


def viewer_command(out: Path) -> list[str]:
    """Return the command that opens the review log in the output directory `out`."""
    from ..io.output_dir import REVIEW

    return [_viewer(), *LOCAL_ONLY, str(out / REVIEW)]


def connect_command(url: str) -> list[str]:
    """Return the command that connects a viewer to the server of a live run."""
    return [_viewer(), *LOCAL_ONLY, "--connect", url]


def _viewer() -> str:
    """Return the viewer on PATH, else that of this Python environment."""
    program = "rerun"
    if shutil.which(program) is None:
        beside = Path(sys.executable).with_name(program)
        program = os.path.relpath(beside) if beside.is_relative_to(Path.cwd()) else str(beside)
    return program


def has_display() -> bool:
    """Return True if a window can be opened."""
    return sys.platform == "darwin" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def open_viewer(command: list[str]) -> None:
    """Start the viewer and do not wait for it; if it cannot be started, print a message."""
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
