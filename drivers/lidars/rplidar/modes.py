"""The scan modes that a device reports. Their ids depend on the firmware, so a mode is chosen by name, or the device's
typical one is used.
"""

from __future__ import annotations

import struct
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

from ...errors import DriverError
from .requests import SCAN, Request, express_scan, get_configuration
from .responses import Info, ResponseType, SampleRate

FIRST_FIRMWARE_WITH_MODES = (1, 24)
"""First firmware of A-series lidars that reports scan modes; time-of-flight models always do."""
FIRST_MODEL_WITH_MODES = 4
"""Major number of the first model that always reports its modes."""
MAX_MODES = 32
"""Modes; a larger number is treated as an error."""


class ConfigEntry(IntEnum):
    """Entries of the configuration. Those from 0x71 to 0x7F, except COUNT and TYPICAL, exist for each mode."""

    ROTATION = 0x01
    MIN_ROTATION = 0x04
    MAX_ROTATION = 0x05
    COUNT = 0x70
    SAMPLE_PERIOD = 0x71
    MAX_DISTANCE = 0x74
    RESPONSE_TYPE = 0x75
    TYPICAL = 0x7C
    NAME = 0x7F


ROTATION_LIMITS: Mapping[int, int] = {ConfigEntry.MIN_ROTATION: 300, ConfigEntry.MAX_ROTATION: 1200}
"""Revolutions per minute between which the heads of RPLIDARs turn, from the data sheets of all models together."""


@dataclass(frozen=True, slots=True)
class ScanMode:
    """A scan mode: id, name, seconds between samples, maximum distance in metres, type of the response."""

    id: int
    name: str
    sample_period: float
    max_distance: float
    response_type: int

    def start(self) -> Request:
        """Return the request that starts it."""
        return SCAN if self.response_type == ResponseType.STANDARD else express_scan(self.id)


@dataclass(frozen=True, slots=True)
class Modes:
    """All scan modes of a device, and the id of the typical one."""

    modes: tuple[ScanMode, ...]
    typical: int

    def choose(self, name: str = "typical") -> ScanMode:
        """Return the typical mode, or the one with a name, ignoring case; raises DriverError with all names."""
        for mode in self.modes:
            if (mode.id == self.typical) if name == "typical" else (mode.name.lower() == name.lower()):
                return mode
        names = ", ".join(mode.name for mode in self.modes) or "none"
        raise DriverError(f"the lidar has no scan mode {name!r}; it has: {names}")


def reports_modes(info: Info) -> bool:
    """Return whether the device reports its scan modes."""
    return info.model >> 4 >= FIRST_MODEL_WITH_MODES or info.firmware >= FIRST_FIRMWARE_WITH_MODES


def legacy_modes(rate: SampleRate, max_distance: float) -> Modes:
    """Return the two modes of firmware that reports none; `max_distance` in metres is the model's."""
    standard = ScanMode(0, "Standard", rate.standard, max_distance, ResponseType.STANDARD)
    return Modes((standard, ScanMode(0, "Express", rate.express, max_distance, ResponseType.EXPRESS)), typical=0)


def query_modes() -> Generator[Request, bytes, Modes]:
    """Query all modes: yield requests, receive the payloads of their responses, and return the modes.

    Raises DriverError if a response is invalid.
    """
    (count,) = yield from _query_numbers(ConfigEntry.COUNT, "<H")
    if not 0 < count <= MAX_MODES:
        raise DriverError(f"the lidar reports {count} scan modes")
    (typical,) = yield from _query_numbers(ConfigEntry.TYPICAL, "<H")
    modes = []
    for mode in range(count):
        (period,) = yield from _query_numbers(ConfigEntry.SAMPLE_PERIOD, "<I", mode)
        (distance,) = yield from _query_numbers(ConfigEntry.MAX_DISTANCE, "<I", mode)
        (response_type,) = yield from _query_numbers(ConfigEntry.RESPONSE_TYPE, "<B", mode)
        name = _parse_text((yield from _query(ConfigEntry.NAME, mode)))
        if period == 0:
            raise DriverError(f"the lidar reports no sample period for scan mode {name!r}")
        modes.append(ScanMode(mode, name, period / 256e6, distance / 256.0, response_type))
    return Modes(tuple(modes), typical)


def query_rotation() -> Generator[Request, bytes, tuple[int, int]]:
    """Query the desired speed: revolutions per minute, and the PWM duty that gives about that speed. Used like
    `query_modes`.
    """
    speed, duty = yield from _query_numbers(ConfigEntry.ROTATION, "<HH")
    return speed, duty


def echo(request: Request) -> bytes:
    """Return the beginning of the response to a configuration request."""
    return request.payload[:4]


def configuration_response(request: Request, modes: Modes, rotation: tuple[int, int] = (600, 660)) -> bytes | None:
    """Return the payload with which a device with these modes responds to a configuration request; None if the entry is
    unknown.

    rotation  desired speed in revolutions per minute, and the PWM duty that gives it
    """
    entry = struct.unpack("<I", request.payload[:4])[0] if len(request.payload) >= 4 else -1
    number = struct.unpack("<H", request.payload[4:6])[0] if len(request.payload) >= 6 else -1
    mode = next((mode for mode in modes.modes if mode.id == number), None)
    if entry == ConfigEntry.ROTATION:
        data = struct.pack("<HH", *rotation)
    elif entry in ROTATION_LIMITS:
        data = struct.pack("<H", ROTATION_LIMITS[entry])
    elif entry == ConfigEntry.COUNT:
        data = struct.pack("<H", len(modes.modes))
    elif entry == ConfigEntry.TYPICAL:
        data = struct.pack("<H", modes.typical)
    elif mode is None:
        return None
    elif entry == ConfigEntry.SAMPLE_PERIOD:
        data = struct.pack("<I", round(mode.sample_period * 256e6))
    elif entry == ConfigEntry.MAX_DISTANCE:
        data = struct.pack("<I", round(mode.max_distance * 256.0))
    elif entry == ConfigEntry.RESPONSE_TYPE:
        data = struct.pack("<B", mode.response_type)
    elif entry == ConfigEntry.NAME:
        data = mode.name.encode("ascii") + b"\0"
    else:
        return None
    return echo(request) + data


def _query(entry: ConfigEntry, mode: int | None) -> Generator[Request, bytes, bytes]:
    """Query one entry; return its data without the echo."""
    request = get_configuration(entry, mode)
    payload = yield request
    if not payload.startswith(echo(request)):
        raise DriverError(f"the lidar was queried for {entry.name} and sent {payload[:16].hex(' ')}")
    return payload[4:]


def _query_numbers(
    entry: ConfigEntry, format: str, mode: int | None = None
) -> Generator[Request, bytes, Sequence[int]]:
    data = yield from _query(entry, mode)
    if len(data) < struct.calcsize(format):
        raise DriverError(f"the lidar's {entry.name} has only {len(data)} bytes")
    return struct.unpack_from(format, data)


def _parse_text(data: bytes) -> str:
    return data.split(b"\0")[0].decode("ascii", errors="replace").strip()
