"""What a person sees of a live run in the terminal: where the robot is, how well that is known, how the devices do."""

from __future__ import annotations

import math
import time
from collections import Counter
from typing import TYPE_CHECKING

from ...events import Event, KeyframeAdded, LoopDecided, Notice, ScanTracked, StateChanged
from ...loop_closure.loop_status import LoopStatus
from ..console import print_message
from ..device_monitor import Rates, format_faults

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

    from drivers.devices.acquisition import Snapshot

COLOURS = {"OK": "green", "DEGENERATE": "yellow", "LOST": "red"}


class LiveDashboard:
    """A sink of the pipeline that keeps what there is to show, and tells of what changes in a line."""

    def __init__(self) -> None:
        self._begun = time.monotonic()
        self._scan: ScanTracked | None = None
        self._state = "OK"
        self._loops: Counter[str] = Counter()
        self._counts: dict[str, int] = {}
        self._notice = ""

    def handle(self, event: Event) -> None:
        """Take one event."""
        match event:
            case ScanTracked():
                self._scan = event
            case KeyframeAdded():
                self._counts = event.counts
            case StateChanged():
                self._state = event.state
                print_message(f"the robot's place: {event.state}")
            case LoopDecided():
                self._loops[event.status] += 1
                if event.status in (LoopStatus.ACCEPTED, LoopStatus.RETRACTED):
                    print_message(f"loop {event.status}: keyframe {event.index} sees the place of keyframe {event.old}")
            case Notice():
                self._notice = event.text

    def draw(self, snapshot: Snapshot, rates: Rates) -> RenderableType:
        """All of it for now: the robot above, the devices below."""
        from rich.console import Group

        return Group(self._robot(snapshot), "", _devices(snapshot, rates))

    def _robot(self, snapshot: Snapshot) -> Table:
        from rich.table import Table

        table = Table.grid(padding=(0, 2))
        minutes, seconds = divmod(int(time.monotonic() - self._begun), 60)
        table.add_row("time", f"{minutes}:{seconds:02d}, {self._lag()}")
        table.add_row("state", f"[bold {COLOURS[self._state]}]{self._state}")
        if self._scan is not None:
            x, y, heading = self._scan.pose
            table.add_row("pose", f"{x:.2f} m, {y:.2f} m, {math.degrees(heading):.0f}°")
            table.add_row("overlap_ratio", f"{100 * self._scan.overlap_ratio:.0f} % of the walls seen are in the map")
        table.add_row("map", ", ".join(f"{count} {name}" for name, count in self._counts.items()))
        table.add_row("loops", ", ".join(f"{count} {name}" for name, count in self._loops.items()) or "none yet")
        if self._notice:
            table.add_row("notice", self._notice)
        table.add_row("dropped, late", f"{snapshot.dropped}, {snapshot.late}")
        return table

    def _lag(self) -> str:
        """How far the map is behind what happens."""
        return "" if self._scan is None else f"{max(0.0, time.time() - self._scan.stamp):.1f} s behind"


def _devices(snapshot: Snapshot, rates: Rates) -> Table:
    """A line for each: state, rate, and what went wrong."""
    from rich.table import Table

    table = Table("device", "state", box=None, pad_edge=False)
    for name in ("messages", "a second"):
        table.add_column(name, justify="right")
    table.add_column("went wrong")
    for device in snapshot.devices:
        wrong = ", ".join(format_faults(device.counters))
        rate = rates.get((device.spec, "messages"), 0.0)
        table.add_row(device.spec, device.state.value, str(device.counters["messages"]), f"{rate:.1f}", wrong)
    return table
