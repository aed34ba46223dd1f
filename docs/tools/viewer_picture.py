"""Draw a review log as the viewer opens it, without a display.

    python docs/tools/viewer_picture.py demo/review.rrd docs/drawings/viewer.png 1280x720

The window's title bar is cut off. A Vulkan driver is needed; a software one is sufficient (mesa-vulkan-drivers).
"""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from PIL import Image
from rerun.experimental import ViewerClient

from slam.visualisation.rerun_log.viewer import viewer_executable

TIMEOUT = 30.0
"""Seconds until the viewer must answer, and until the log must be loaded."""
SETTLING = 2.0
"""Seconds until everything is drawn."""
TITLE_BAR = 38
"""Height of the window's title bar, pixels; it warns of the software driver."""


def take_picture(log: Path, picture: Path, size: str) -> list[str]:
    """Draw `log` in a window of a `size` such as 1280x720 pixels into `picture`; return the errors of its views."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    options = ["--headless", "--window-size", size, "--port", str(port), "--bind", "127.0.0.1", "--hide-welcome-screen"]
    quiet = subprocess.DEVNULL
    with subprocess.Popen([viewer_executable(), *options], stdout=quiet, stderr=quiet) as process:
        try:
            client = _connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.open(str(log))
            _wait_until_loaded(client)
            time.sleep(SETTLING)
            errors = [f"{view.name}: {report.summary}" for view in client.get_state().views for report in view.reports]
            client.save_screenshot(str(picture))
        finally:
            process.terminate()
    with Image.open(picture) as drawn:
        inside = drawn.convert("RGB").crop((0, TITLE_BAR, drawn.width, drawn.height))
    inside.save(picture, optimize=True)
    return errors


def _connect(url: str) -> Any:
    deadline = time.monotonic() + TIMEOUT
    while True:
        try:
            client = ViewerClient.connect(url)
            client.get_state()
            return client
        except Exception:  # the viewer's client does not document its errors
            if time.monotonic() > deadline:
                raise
            time.sleep(0.2)


def _wait_until_loaded(client: Any) -> None:
    deadline = time.monotonic() + TIMEOUT
    while time.monotonic() < deadline:
        state = client.get_state()
        if not state.loading and state.recordings and state.recordings[0].timelines:
            return
        time.sleep(0.1)
    raise TimeoutError("the viewer does not load the log")


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    for error in take_picture(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]):
        print(error, file=sys.stderr)
