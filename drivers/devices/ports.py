"""Connections opened from device specs, and the list of serial ports."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from serial.tools import list_ports

from ..errors import PortError
from ..transport import CapturingTransport, ReplayTransport, SerialPort, TcpConnection, Transport
from .device_spec import AUTO, CAPTURE_PREFIX, DeviceSpec


@dataclass(frozen=True, slots=True)
class Port:
    """A serial port: its path, and the description that its adapter reports."""

    path: str
    description: str


def serial_ports() -> list[Port]:
    """Return the serial ports of adapters and boards, without the host's built-in ports, which lead nowhere."""
    found = [Port(port.device, port.description or "") for port in list_ports.comports() if port.vid is not None]
    return sorted(found, key=lambda port: port.path)


def searches_ports(spec: DeviceSpec, moved: bool) -> bool:
    """Return whether a device is searched on ports that the user did not name; `moved` if it may be at another port
    now.
    """
    return spec.address == AUTO or (moved and spec.tcp is None and not spec.address.startswith(CAPTURE_PREFIX))


def candidate_addresses(spec: DeviceSpec, moved: bool, other_addresses: Collection[str]) -> Iterator[str]:
    """Yield the addresses to try: the device's own, and if it is searched, all ports except those of other devices."""
    if spec.address != AUTO:
        yield spec.address
    if searches_ports(spec, moved):
        named = {Path(address).resolve() for address in (*other_addresses, spec.address)}
        yield from (port.path for port in serial_ports() if Path(port.path).resolve() not in named)


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
