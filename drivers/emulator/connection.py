"""A device, its line and its port, and the transport of bytes between them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import asdict, dataclass

import numpy as np

from .device import EmulatedDevice
from .emulator_setup import FaultEvent
from .pty_port import PtyPort
from .serial_line import Corruptor

BAUD_TOLERANCE = 0.03
"""Relative difference of the baud rates of both ends up to which bytes are still understood."""


@dataclass(slots=True)
class ConnectionCounts:
    """Counts of what happened, in bytes except for the events.

    sent      to a port that a program had open
    received  from the host
    unheard   sent by the device while no program had its port open
    overrun   sent by the device while the program with the open port did not read
    garbled   in either direction while the program had set a wrong baud rate
    stalled, unplugged  in either direction lost to these faults
    unplugs, stalls, restarts, fails  faults so far
    """

    sent: int = 0
    received: int = 0
    unheard: int = 0
    overrun: int = 0
    garbled: int = 0
    stalled: int = 0
    unplugged: int = 0
    unplugs: int = 0
    stalls: int = 0
    restarts: int = 0
    fails: int = 0


class DeviceConnection:
    """Connection between a device and its port; it steps the device and carries the bytes.

    events     faults of the device
    corruptor  applied to bytes sent by the device
    """

    def __init__(
        self,
        device: EmulatedDevice,
        port: PtyPort,
        events: Iterable[FaultEvent],
        corruptor: Corruptor,
        random: np.random.Generator,
    ) -> None:
        self.device, self.port, self.counts = device, port, ConnectionCounts()
        self._events = deque(sorted(events, key=lambda event: event.time))
        self._corruptor, self._random = corruptor, random
        self._opened = False
        self._plug_at = self._stalled_until = -math.inf
        device.switch_on(0.0)

    @property
    def due(self) -> float:
        """Time at which it should be stepped next."""
        event = self._events[0].time if self._events else math.inf
        plug = self._plug_at if not self.port.is_plugged else math.inf
        return min(self.device.due, self.device.line.due, event, plug)

    def step(self, time: float) -> None:
        """Process everything up to a time."""
        while self._events and self._events[0].time <= time:
            self._apply_event(self._events.popleft(), time)
        if not self.port.is_plugged and time >= self._plug_at:
            self.port.plug()
            if self.device.usb_powered:
                self.device.switch_on(time)
        is_open = self.port.is_open
        if is_open and not self._opened:
            self.device.on_port_opened(time)
        self._opened = is_open
        if received := self.port.read():
            self._pass_to_device(received, time)
        self.device.advance(time)
        if sent := self.device.line.read(time):
            self._pass_to_port(sent, time)

    def _apply_event(self, event: FaultEvent, time: float) -> None:
        device, counts = self.device, self.counts
        if event.kind == "unplug":
            counts.unplugs += 1
            self.port.unplug()
            self._plug_at = max(self._plug_at, event.time + event.duration)
            if device.usb_powered:
                device.switch_off()
                counts.unplugged += device.line.clear(time)
        elif event.kind == "stall":
            counts.stalls += 1
            self._stalled_until = max(self._stalled_until, event.time + event.duration)
        elif event.kind == "fail":
            counts.fails += device.inject_error(time)
        elif device.on:
            counts.restarts += 1
            device.switch_off()
            device.line.clear(time)
            device.switch_on(time)

    def _pass_to_device(self, data: bytes, time: float) -> None:
        """Pass bytes from the host to the device."""
        self.counts.received += len(data)
        if time < self._stalled_until:
            self.counts.stalled += len(data)
        elif self._is_baud_wrong():
            self.counts.garbled += len(data)
        else:
            self.device.receive(data, time)

    def _pass_to_port(self, data: bytes, time: float) -> None:
        """Pass bytes from the device to the host."""
        counts = self.counts
        if not self.port.is_plugged:
            counts.unplugged += len(data)
        elif time < self._stalled_until:
            counts.stalled += len(data)
        elif not self._opened:
            counts.unheard += len(data)
        else:
            if self._is_baud_wrong():
                counts.garbled += len(data)
                data = self._random.bytes(len(data))
            arriving = self._corruptor(data)
            consumed = self.port.write(arriving)
            counts.sent += consumed
            counts.overrun += len(arriving) - consumed

    def _is_baud_wrong(self) -> bool:
        """Return whether the program has set a baud rate other than the line's."""
        baud, set_to = self.device.line.baud, self.port.baud
        return set_to is not None and math.isfinite(baud) and abs(set_to / baud - 1.0) > BAUD_TOLERANCE

    def report(self) -> dict[str, object]:
        """Return all counts by name."""
        device = self.device
        return {
            "device": device.name,
            "baud": device.line.baud if math.isfinite(device.line.baud) else None,
            "port": str(self.port.path),
            **asdict(self.counts),
            **asdict(self._corruptor.counts),
            "overflow": device.line.overflow,
            "misheard": device.unrecognised,
            "requests": device.requests,
            "starts": 1 + device.restarts,
            **device.report(),
        }
