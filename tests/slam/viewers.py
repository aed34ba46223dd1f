"""A real viewer without a window."""

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
    """It needs a Vulkan driver; a software one does (mesa-vulkan-drivers). Without one the test is skipped."""
    drivers = [folder for folder in VULKAN_DRIVERS if any(folder.glob("*.json"))]
    if sys.platform == "linux" and not drivers:
        pytest.skip("no Vulkan driver is installed")  # the viewer would come up, and die when it draws
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    executable = str(Path(rerun_cli.__file__).with_name("rerun"))
    try:
        client = ViewerClient.spawn(headless=True, port=port, hide_welcome_screen=True, executable_path=executable)
    except Exception as error:  # the viewer's client does not say which errors it raises
        pytest.skip(f"the viewer does not come up, perhaps there is no Vulkan driver: {error}")
    deadline = time.monotonic() + 10
    while True:
        try:
            client.get_state()
            return client
        except Exception as error:
            if time.monotonic() > deadline:
                client.quit()
                pytest.skip(f"the viewer does not come up, perhaps there is no Vulkan driver: {error}")
            time.sleep(0.2)


def load(client: Any, path: Path) -> None:
    client.open(str(path))
    for _ in range(200):
        state = client.get_state()
        if not state.loading and state.recordings and state.recordings[0].timelines:
            return
        time.sleep(0.1)
    pytest.fail("the viewer does not load the log")


def troubles(client: Any) -> list[tuple[str, str]]:
    """What views report and what the viewer logs as an error."""
    reports = [(view.name, report.summary) for view in client.get_state().views for report in view.reports]
    return reports + [("log", line.message) for line in client.get_logs() if line.level == "ERROR"]


def pixels_of(image: np.ndarray, colour: Colour) -> int:
    return int((np.abs(image.astype(int) - colour[:3]).max(axis=-1) < 40).sum())
