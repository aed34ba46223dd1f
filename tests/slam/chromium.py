"""A browser that prints a page after its scripts have run."""

import shutil
import subprocess
from pathlib import Path

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-logging=stderr",
    "--virtual-time-budget=3000",
    "--dump-dom",
)
in_a_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed (apt-get install chromium)")


def render(file: Path, size: str = "1280,900") -> tuple[str, list[str]]:
    """Return the document after its scripts have run, and the lines of the browser's console."""
    assert CHROMIUM is not None
    profile = file.parent / f"profile-{file.stem}"
    command = [CHROMIUM, *FLAGS, f"--window-size={size}", f"--user-data-dir={profile}", file.as_uri()]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    return answer.stdout, [line for line in answer.stderr.splitlines() if "CONSOLE" in line]
