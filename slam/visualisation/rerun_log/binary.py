"""The viewer's program."""

from __future__ import annotations

from pathlib import Path

import rerun_cli


def viewer_binary() -> str:
    """The viewer itself. What is on the path as `rerun` is a script that starts it, and leaves it alone when killed."""
    name = Path(rerun_cli.__file__).with_name("rerun")
    return str(name if name.exists() else name.with_suffix(".exe"))
