"""Connections opened from device specs, and the list of serial ports."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from serial.tools import list_ports

from ..errors import PortError
from ..transport import CapturingTransport, ReplayTransport, SerialPort, TcpConnection, Transport
from .board_ports import board_ports
from .device_spec import AUTO, CAPTURE_PREFIX, DeviceSpec

PERMANENT_NAMES = Path("/dev/serial/by-id")
"""Links to serial ports, named by udev after the serial numbers of their adapters."""


@dataclass(frozen=True, slots=True)
class Port:
    """A serial port: its path, its description, and whether the system's console is there."""

    path: str
    description: str
    is_console: bool = False


def serial_ports() -> list[Port]:
    """Return the serial ports of adapters and of boards on USB, without the computer's own ports."""
    found = [Port(port.device, port.description or "") for port in list_ports.comports() if port.vid is not None]
    return sorted(found, key=lambda port: port.path)


def built_in_ports() -> list[Port]:
    """Return the UARTs of the board, for example on the pins of a Raspberry Pi; see `board_ports`."""
    text = "UART of this board"
    return [
        Port(path, f"{text}, the system's console" if is_console else text, is_console)
        for path, is_console in board_ports().items()
    ]


def permanent_names(address: str) -> list[str]:
    """Return the names of a serial port that its adapter keeps if it gets another number, in PERMANENT_NAMES."""
    path = Path(address).resolve()
    if not PERMANENT_NAMES.is_dir():
        return []
    return sorted(str(name) for name in PERMANENT_NAMES.iterdir() if name.resolve() == path)


def candidate_addresses(spec: DeviceSpec, names: Collection[str], other_addresses: Collection[str]) -> Iterator[str]:
    """Yield the addresses to try, never one of another device.

    Opening a port changes its modem lines, which restarts many boards. So all ports are tried only if the user allowed
    it with `auto`. Otherwise these are the device's own address and `names`, the permanent names that it had.
    """
    if spec.address != AUTO:
        yield from _own_addresses(spec.address, names)
        return
    others = {Path(address).resolve() for address in other_addresses}
    for port in serial_ports():
        path = Path(port.path).resolve()
        if path.exists() and path not in others:
            yield port.path


def _own_addresses(address: str, names: Collection[str]) -> Iterator[str]:
    """Yield the address of a device and those of `names` under which its adapter is found now, without repetition.

    If several adapters were plugged in again, as after a fault of their hub, they may have exchanged their numbers. So
    the address comes last if the adapter is elsewhere, and is left out if it has become that of another adapter.
    """
    paths = {Path(name).resolve(): name for name in names if Path(name).exists()}
    own = Path(address).resolve()
    if own in paths or not names or not permanent_names(address):
        paths[own] = address
    yield from paths.values()


def connect(spec: DeviceSpec, address: str, baud: int, dtr: bool, append: bool = False) -> Transport:
    """Open a connection; raises PortError.

    A byte capture is played at its original speed. If the device's bytes are captured and `append` is set, they are
    appended to the capture of an earlier connection.
    """
    if address.startswith(CAPTURE_PREFIX):
        return ReplayTransport(address.removeprefix(CAPTURE_PREFIX), paced=True)
    transport: Transport = TcpConnection(*spec.tcp) if spec.tcp is not None else SerialPort(address, baud, dtr)
    if "tape" not in spec.options:
        return transport
    try:
        return CapturingTransport(transport, spec.options["tape"], append)
    except PortError:
        transport.close()
        raise
