"""State of a live run in the terminal: pose, localisation status, map and devices."""

from __future__ import annotations

import math
import time
from collections import Counter
from typing import TYPE_CHECKING

from ...events import (
    Event,
    KeyframeAdded,
    LoopDecided,
    ModeChanged,
    Notice,
    Relocalised,
    ScanTracked,
    StateChanged,
)
from ...formatting import counted
from ...loop_closure.loop_status import LoopStatus
from ..console import print_message
from ..device_monitor import Rates, format_faults

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

    from drivers.devices.snapshot import Snapshot

COLOURS = {"OK": "green", "DEGENERATE": "yellow", "LOST": "red"}


class LiveDashboard:
    """Sink that keeps the current state of the run and prints changes of it as messages.

    drive_keys  explanation of the keys that drive the robot; empty: there are none
    """

    handled = (ScanTracked, KeyframeAdded, StateChanged, ModeChanged, LoopDecided, Notice, Relocalised)

    def __init__(self, drive_keys: str = "") -> None:
        self._drive_keys = drive_keys
        self._start = time.monotonic()
        self._scan: ScanTracked | None = None
        self._state, self._frozen = "OK", False
        self._loops: Counter[str] = Counter()
        self._counts: dict[str, int] = {}
        self._notice = ""

    def handle(self, event: Event) -> None:
        """Process one event."""
        match event:
            case ScanTracked():
                self._scan = event
            case KeyframeAdded():
                self._counts = event.counts
            case StateChanged():
                self._state = event.state
                print_message(f"localisation status: {event.state}")
            case ModeChanged():
                self._frozen = event.frozen
            case LoopDecided():
                self._loops[event.status] += 1
                if event.status in (LoopStatus.ACCEPTED, LoopStatus.RETRACTED):
                    print_message(f"loop closure {event.status}: keyframe {event.index} to keyframe {event.old}")
            case Notice() if event.level != "TRACE":
                self._notice = event.text
            case Relocalised():
                x, y, heading = event.pose
                print_message(f"relocalised at {x:.2f} m, {y:.2f} m, {math.degrees(heading):.0f}°")

    def render(self, snapshot: Snapshot, rates: Rates) -> RenderableType:
        """Return the state of the run above that of the devices."""
        from rich.console import Group

        return Group(self._run_table(snapshot), "", _device_table(snapshot, rates))

    def _run_table(self, snapshot: Snapshot) -> Table:
        from rich.table import Table

        table = Table.grid(padding=(0, 2))
        minutes, seconds = divmod(int(time.monotonic() - self._start), 60)
        table.add_row("time", f"{minutes}:{seconds:02d}{self._delay(snapshot.clock_offset)}")
        mode = ", the map is only localised in" if self._frozen else ""
        table.add_row("status", f"[bold {COLOURS[self._state]}]{self._state}[/]{mode}")
        if self._scan is not None:
            x, y, heading = self._scan.pose
            table.add_row("pose", f"{x:.2f} m, {y:.2f} m, {math.degrees(heading):.0f}°")
            table.add_row(
                "overlap", f"{100 * self._scan.overlap_ratio:.0f} % of the observed wall length is in the map"
            )
        table.add_row("map", ", ".join(counted(count, name.removesuffix("s")) for name, count in self._counts.items()))
        table.add_row("loops", ", ".join(f"{count} {name}" for name, count in self._loops.items()) or "none")
        if self._notice:
            table.add_row("notice", self._notice)
        table.add_row("dropped, late", f"{snapshot.dropped}, {snapshot.late}")
        table.add_row("keys", "s: save the map now, l: only localise or extend the map, Ctrl-C: save and end")
        if self._drive_keys:
            table.add_row("", self._drive_keys)
        return table

    def _delay(self, clock_offset: float) -> str:
        """Return the delay of the estimate after the measurement, also if the wall clock was set since the start."""
        if self._scan is None:
            return ""
        return f", delay {max(0.0, time.monotonic() + clock_offset - self._scan.stamp):.1f} s"


def _device_table(snapshot: Snapshot, rates: Rates) -> Table:
    """Return a table with the state, the message rate and the faults of each device."""
    from rich.table import Table

    table = Table("device", "state", box=None, pad_edge=False)
    for name in ("messages", "per second"):
        table.add_column(name, justify="right")
    table.add_column("faults")
    for device in snapshot.devices:
        faults = ", ".join(format_faults(device.counters))
        rate = rates.get((device.spec, "messages"), 0.0)
        table.add_row(device.spec, device.state.value, str(device.counters["messages"]), f"{rate:.1f}", faults)
    return table
