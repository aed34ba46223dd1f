"""The page of a live run: its address, and what it shows besides the events."""

from __future__ import annotations

import re
import time
from typing import TYPE_CHECKING

import typer

from ..console import print_message
from ..device_monitor import format_faults

if TYPE_CHECKING:
    from drivers.devices.acquisition import Acquisition
    from drivers.devices.driving import DriveLimits
    from drivers.devices.snapshot import Snapshot

    from ...visualisation.live_page import PageServer

DEVICES_PERIOD = 1.0
"""Seconds between two updates of the devices on the page."""
ADDRESS_PATTERN = re.compile(r"(?P<host>[^:\[\]]+|\[[0-9a-fA-F:]+\])(?::(?P<port>[0-9]{1,5}))?")


def open_page(address: str | None) -> PageServer:
    """Return the server of the page at HOST or HOST:PORT, not yet entered.

    Raises MissingExtraError without tornado, OutputError if the port is taken or this computer does not have the
    address, BadParameter if the address has another form.
    """
    from ...extras import require_extra

    match = ADDRESS_PATTERN.fullmatch("127.0.0.1" if address is None else address)
    if match is None or int(match["port"] or 1) not in range(1, 65536):
        raise typer.BadParameter(f"{address}: must be HOST or HOST:PORT", param_hint="--web-address")
    require_extra("web")
    from ...visualisation.live_page import LiveState, PageServer

    return PageServer(LiveState(), match["host"].strip("[]"), int(match["port"]) if match["port"] else None)


class PageControl:
    """Connection of the page with the devices: their state is shown, and its buttons act on them."""

    def __init__(self, page: PageServer, acquisition: Acquisition, driving: DriveLimits | None) -> None:
        self._state, self._acquisition = page.state, acquisition
        self._shown_at = 0.0
        page.actions.pause = self._pause
        if driving is not None:
            page.actions.drive = acquisition.drive
            page.actions.limits = driving.speed, driving.turn_rate
        self._state.update(can_pause=True, can_drive=driving is not None)

    def show(self, snapshot: Snapshot) -> None:
        """Show the devices, once per DEVICES_PERIOD; cheap otherwise."""
        if time.monotonic() < self._shown_at + DEVICES_PERIOD:
            return
        self._shown_at = time.monotonic()
        devices = [(one.spec, one.state.value, ", ".join(format_faults(one.counters))) for one in snapshot.devices]
        self._state.update(devices=devices)

    def _pause(self, paused: bool) -> None:
        self._acquisition.pause(paused)
        self._state.update(paused=paused)
        print_message("paused: scans are left out" if paused else "scans are used again")
