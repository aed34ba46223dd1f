"""Where devices are: connections opened from specs, and the serial ports there are."""

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
    """A serial port: its path, and what the adapter behind it says that it is."""

    path: str
    description: str


def serial_ports() -> list[Port]:
    """The serial ports of adapters and boards; without those that are soldered to the host and lead nowhere."""
    found = [Port(port.device, port.description or "") for port in list_ports.comports() if port.vid is not None]
    return sorted(found, key=lambda port: port.path)


def searches_ports(spec: DeviceSpec, moved: bool) -> bool:
    """Whether a device is to be looked for on ports that nobody named; `moved` says that it may be elsewhere now."""
    return spec.address == AUTO or (moved and spec.tcp is None and not spec.address.startswith(CAPTURE_PREFIX))


def candidate_addresses(spec: DeviceSpec, moved: bool, other_addresses: Collection[str]) -> Iterator[str]:
    """Where to look for a device: at its address, and where it is searched on all ports but those of other devices."""
    if spec.address != AUTO:
        yield spec.address
    if searches_ports(spec, moved):
        named = {Path(address).resolve() for address in (*other_addresses, spec.address)}
        yield from (port.path for port in serial_ports() if Path(port.path).resolve() not in named)


def connect(spec: DeviceSpec, address: str, baud: int, dtr: bool, append: bool = False) -> Transport:
    """Open a connection; raises PortError. Tapes play in their own time. A tape that is recorded is gone on with if
    the device is connected `again`.
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
