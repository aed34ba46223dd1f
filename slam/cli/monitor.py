"""How devices are doing, in a terminal: a table while it runs, lines on stderr where something changes."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeAlias

from .console import complain

if TYPE_CHECKING:
    from rich.console import RenderableType

    from drivers.devices.acquisition import Acquisition, Snapshot
    from drivers.messages import Message

PERIOD = 0.25
"""Seconds between two looks of the table."""
LOOK_UP = 0.1
"""Seconds without a message after which it is seen what else there is to do."""

Rates: TypeAlias = Mapping[tuple[str, str], float]
"""Counts a second, of (spec of a device, counter)."""


def attended(acquisition: Acquisition, seconds: float | None, look: Callable[[Snapshot], None]) -> Iterator[Message]:
    """The messages until the devices are stopped, which happens after so many seconds, if they are not None; `look` is
    called several times a second. Raises DriverError where the acquisition breaks down.
    """
    end = float("inf") if seconds is None else time.monotonic() + seconds
    while not acquisition.ended:
        message = acquisition.receive(LOOK_UP)
        if message is not None:
            yield message
        look(acquisition.snapshot)
        if time.monotonic() >= end:
            end = float("inf")
            acquisition.stop()


@contextmanager
def stopping(acquisition: Acquisition, saying: str = "") -> Iterator[None]:
    """Ctrl-C and being told to terminate stop the devices, and what is inside the context goes on to its end; a second
    Ctrl-C interrupts it. `saying` is told when it comes to that.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(*_: Any) -> None:
        acquisition.stop()
        if saying:
            complain(saying)
        signal.signal(signal.SIGINT, signal.default_int_handler)

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class Monitor:
    """A context that shows snapshots on stderr: what `draw` makes of them if that is a terminal, else what changes."""

    def __init__(self, draw: Callable[[Snapshot, Rates], RenderableType] | None = None) -> None:
        self._draw = draw or counters_table
        self._live: Any = None
        self._lost: set[str] = set()
        self._earlier: tuple[float, Snapshot] | None = None
        self._rates: dict[tuple[str, str], float] = {}
        self._shown = 0.0

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
            self._live.stop()

    def show(self, snapshot: Snapshot) -> None:
        """Show it, if it is time to; cheap otherwise."""
        self._tell_changes(snapshot)
        now = time.monotonic()
        if self._live is None or now < self._shown + PERIOD:
            return
        self._shown = now
        self._measure(now, snapshot)
        self._live.update(self._draw(snapshot, self._rates), refresh=True)

    def _tell_changes(self, snapshot: Snapshot) -> None:
        from drivers.devices.supervisor import State

        for device in snapshot.devices:
            was_lost = device.spec in self._lost
            if device.state is State.LOST and not was_lost:
                self._lost.add(device.spec)
                complain(f"{device.spec} lost: {device.problem}")
            elif device.state is State.RUNNING and was_lost:
                self._lost.remove(device.spec)
                complain(f"{device.spec} is back on {device.port}")

    def _measure(self, now: float, snapshot: Snapshot) -> None:
        """Counts a second, over at least a second."""
        if self._earlier is None or now - self._earlier[0] >= 1.0:
            if self._earlier is not None:
                then, earlier = self._earlier
                old = {device.spec: device.counters for device in earlier.devices}
                self._rates = {
                    (device.spec, name): (count - old.get(device.spec, {}).get(name, 0)) / (now - then)
                    for device in snapshot.devices
                    for name, count in device.counters.items()
                }
            self._earlier = (now, snapshot)


def troubles_in_words(counters: Mapping[str, int]) -> list[str]:
    """What went wrong with a device, as `checksum failures 3`."""
    from drivers.devices.supervisor import troubles

    return [f"{name.replace('_', ' ')} {count}" for name, count in troubles(counters).items()]


def counters_table(snapshot: Snapshot, rates: Rates) -> RenderableType:
    """All counters of all devices."""
    from rich.table import Table

    table = Table("device", "counter", box=None, pad_edge=False)
    for name in ("count", "a second"):
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
