"""State of the devices in the terminal: a live table, or lines on stderr when a device is lost or found again."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeAlias

from .console import print_message

if TYPE_CHECKING:
    from rich.console import RenderableType

    from drivers.devices.snapshot import Snapshot

REFRESH_PERIOD = 0.25
"""Seconds between two updates of the table."""
RATE_PERIOD = 1.0
"""Shortest time over which a rate is computed, seconds."""

Rates: TypeAlias = Mapping[tuple[str, str], float]
"""Counts per second, by device spec and name of the counter."""


class DeviceMonitor:
    """Context that shows device snapshots on stderr.

    On a terminal `render` turns each snapshot into a live table, by default of all counters; elsewhere only changes of
    state are printed.
    """

    def __init__(self, render: Callable[[Snapshot, Rates], RenderableType] | None = None) -> None:
        self._render = render or counters_table
        self._live: Any = None
        self._lost: set[str] = set()
        self._rate_start: tuple[float, Snapshot] | None = None
        self._rates: dict[tuple[str, str], float] = {}
        self._refreshed = 0.0

    def __enter__(self) -> Self:
        from rich.console import Console
        from rich.live import Live

        console = Console(stderr=True)
        if console.is_terminal:
            self._live = Live(console=console, auto_refresh=False, transient=True)
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            with suppress(OSError):
                self._live.stop()

    def show(self, snapshot: Snapshot) -> None:
        """Print changes of state, and update the table once per REFRESH_PERIOD; cheap otherwise."""
        self._print_changes(snapshot)
        now = time.monotonic()
        if self._live is None or now < self._refreshed + REFRESH_PERIOD:
            return
        self._refreshed = now
        self._update_rates(now, snapshot)
        with suppress(OSError):  # the terminal is gone
            self._live.update(self._render(snapshot, self._rates), refresh=True)

    def _print_changes(self, snapshot: Snapshot) -> None:
        from drivers.devices.supervisor import DeviceState

        for device in snapshot.devices:
            was_lost = device.spec in self._lost
            if device.state is DeviceState.LOST and not was_lost:
                self._lost.add(device.spec)
                print_message(f"{device.spec} lost: {device.problem}")
            elif device.state is DeviceState.RUNNING and was_lost:
                self._lost.remove(device.spec)
                print_message(f"{device.spec} connected again on {device.port}")

    def _update_rates(self, now: float, snapshot: Snapshot) -> None:
        """Compute the rates since the last snapshot that is at least RATE_PERIOD old."""
        if self._rate_start is None or now - self._rate_start[0] >= RATE_PERIOD:
            if self._rate_start is not None:
                then, earlier = self._rate_start
                old = {device.spec: device.counters for device in earlier.devices}
                self._rates = {
                    (device.spec, name): (count - old.get(device.spec, {}).get(name, 0)) / (now - then)
                    for device in snapshot.devices
                    for name, count in device.counters.items()
                }
            self._rate_start = (now, snapshot)


def format_faults(counters: Mapping[str, int]) -> list[str]:
    """Return the fault counters of a device that are not zero, as `checksum failures 3`."""
    from drivers.devices.supervisor import fault_counters

    return [f"{name.replace('_', ' ')} {count}" for name, count in fault_counters(counters).items()]


def counters_table(snapshot: Snapshot, rates: Rates) -> RenderableType:
    """Return a table of all counters of all devices."""
    from rich.table import Table

    table = Table("device", "counter", box=None, pad_edge=False)
    for name in ("count", "per second"):
        table.add_column(name, justify="right")
    for device in snapshot.devices:
        age = "" if device.age is None else f", last message {device.age:.2f} s ago"
        table.add_row(device.spec, f"[bold]{device.state.value}[/bold]{age}")
        for text in filter(None, (device.identity, device.problem)):
            table.add_row("", text)
        for name, count in device.counters.items():
            rate = rates.get((device.spec, name), 0.0)
            table.add_row("", name.replace("_", " "), f"{count}", f"{rate:.1f}" if rate else "")
    table.add_row("all", "dropped, late", f"{snapshot.dropped}, {snapshot.late}")
    return table
