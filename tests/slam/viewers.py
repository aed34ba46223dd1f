"""Run a real, headless Rerun viewer in tests."""

from __future__ import annotations

import socket
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun_cli
from rerun.experimental import ViewerClient

from slam.visualisation.rerun_log.colours import Colour

VULKAN_DRIVERS = (Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d"))


def viewer() -> Any:
    """Start a viewer; skip the test without a Vulkan driver, for example the software one (mesa-vulkan-drivers)."""
    drivers = [folder for folder in VULKAN_DRIVERS if any(folder.glob("*.json"))]
    if sys.platform == "linux" and not drivers:
        pytest.skip("no Vulkan driver is installed")  # the viewer would start, and crash when it draws
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    executable = str(Path(rerun_cli.__file__).with_name("rerun"))
    try:
        client = ViewerClient.spawn(headless=True, port=port, hide_welcome_screen=True, executable_path=executable)
    except Exception as error:  # the viewer's client does not document its errors
        pytest.skip(f"the viewer does not start, perhaps for lack of a Vulkan driver: {error}")
    deadline = time.monotonic() + 60
    while True:
        try:
            client.get_state()
            return client
        except Exception as error:
            if time.monotonic() > deadline:
                client.quit()
                pytest.skip(f"the viewer does not start, perhaps for lack of a Vulkan driver: {error}")
            time.sleep(0.2)


def load(client: Any, path: Path) -> None:
    """Open a log and wait until it is loaded."""
    client.open(str(path))
    for _ in range(200):
        state = client.get_state()
        if not state.loading and state.recordings and state.recordings[0].timelines:
            return
        time.sleep(0.1)
    pytest.fail("the viewer does not load the log")


def errors(client: Any) -> list[tuple[str, str]]:
    """Return the reports of the views and the errors in the viewer's log."""
    reports = [(view.name, report.summary) for view in client.get_state().views for report in view.reports]
    return reports + [("log", line.message) for line in client.get_logs() if line.level == "ERROR"]


def pixels_of(image: np.ndarray, colour: Colour) -> int:
    """Return the number of pixels close to a colour."""
    return int((np.abs(image.astype(int) - colour[:3]).max(axis=-1) < 40).sum())
