"""What a user types for a device: `rplidar:/dev/ttyUSB0?mode=Standard&mount=0.1,0,0`.

A spec is a kind, where the device is, and options:

    /dev/ttyUSB0    a serial port
    192.168.0.10:10940   host:port, raw bytes over TCP
    auto            whichever serial port such a device answers on
    tape:FILE       raw bytes recorded earlier, played with their times

Several devices are joined by a plus sign between spaces.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import unquote

import numpy as np

from ..errors import DriverError

AUTO = "auto"
TAPE = "tape:"
TCP = re.compile(r"(?P<host>[^/:\[\]]+|\[[0-9a-fA-F:]+\]):(?P<port>[0-9]{1,5})")


class SpecError(DriverError):
    """A device's spec is wrong; says what would be right."""


@dataclass(frozen=True, slots=True)
class DeviceSpec:
    """A device as a user asked for it: its kind, its address, its options in their types, and the text typed."""

    kind: str
    address: str
    options: Mapping[str, Any]
    text: str

    @property
    def is_lidar(self) -> bool:
        """Whether it is a lidar; else it is a base."""
        return KINDS[self.kind].is_lidar

    @property
    def tcp(self) -> tuple[str, int] | None:
        """Host and port, where the device is behind a network."""
        match = TCP.fullmatch(self.address)
        return (match["host"].strip("[]"), int(match["port"])) if match else None


@dataclass(frozen=True, slots=True)
class Kind:
    """Of devices: whether it is a lidar, what options it takes, and which of them it needs."""

    is_lidar: bool
    options: Mapping[str, Callable[[str], Any]]
    needed: tuple[str, ...] = ()


def _numbers(count: int) -> Callable[[str], Any]:
    def convert(text: str) -> Any:
        values = [float(part) for part in text.split(",")]
        if len(values) != count or not all(map(math.isfinite, values)):
            raise ValueError(f"{count} numbers with commas are needed")
        return np.array(values)

    return convert


def _pair(text: str) -> tuple[float, float]:
    """The left and the right wheel's; one number is for both."""
    values = [float(part) for part in text.split(",")]
    if len(values) not in (1, 2) or not all(math.isfinite(value) and value != 0.0 for value in values):
        raise ValueError("one number, or the left and the right wheel's with a comma, is needed")
    return values[0], values[-1]


def _positive(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError("a number above 0 is needed")
    return value


def _whole(text: str) -> int:
    value = int(text)
    if value <= 0:
        raise ValueError("a whole number above 0 is needed")
    return value


def _yes(text: str) -> bool:
    if text not in ("0", "1"):
        raise ValueError("1 (yes) or 0 (no) is needed")
    return text == "1"


def _text(text: str) -> str:
    if not text:
        raise ValueError("it is empty")
    return text


COMMON = {"baud": _whole, "tape": _text}
LIDAR = {**COMMON, "mount": _numbers(3), "upside_down": _yes, "range_min": _positive, "range_max": _positive}
WHEELS = {
    **COMMON,
    "wheel_radius": _pair,
    "ticks": _pair,
    "track": _positive,
    "top_speed": _positive,
    "bits": _whole,
    "dtr": _yes,
}
MEASURES = ("wheel_radius", "ticks", "track")

KINDS: dict[str, Kind] = {
    "rplidar": Kind(True, {**LIDAR, "mode": _text, "serial": _text}),
    "ld06": Kind(True, LIDAR),
    "scip": Kind(True, {**LIDAR, "serial": _text}),
    "create2": Kind(False, WHEELS),
    "kobuki": Kind(False, WHEELS),
    "arduino": Kind(False, WHEELS, MEASURES),
    "wheels": Kind(False, WHEELS, MEASURES),
}
"""All kinds of devices.

Options of all: `baud` bits a second, `tape` a file to write the raw bytes to. Of lidars: `mount` x,y,heading on the
base (metres, radians), `upside_down`, `range_min`, `range_max` (metres), `mode` (its name), `serial` number. Of bases:
`wheel_radius` (metres; two numbers for different wheels), `ticks` counts a turn of a wheel (negative where they count
backwards), `track` (metres), `top_speed` of a wheel (m/s), `bits` of the counters, `dtr` whether the line is asserted.
"""


def is_device(text: str) -> bool:
    """Whether a text names devices rather than a recording."""
    return text.partition(":")[0].strip() in KINDS and ":" in text


def parse_devices(text: str) -> list[DeviceSpec]:
    """The devices in a text such as `rplidar:/dev/ttyUSB0 + create2:/dev/ttyUSB1`; raises SpecError."""
    specs = [parse_device(part) for part in re.split(r"\s+\+\s+", text.strip())]
    addresses = [spec.address for spec in specs if spec.address != AUTO]
    for address in addresses:
        if addresses.count(address) > 1:
            raise SpecError(f"{text}: {address} is asked for twice")
    return specs


def parse_device(text: str) -> DeviceSpec:
    """One device; raises SpecError where it is none."""
    text = text.strip()
    name, colon, rest = text.partition(":")
    if not colon or name not in KINDS:
        raise SpecError(f"{text}: not a device; there are {', '.join(f'{kind}:PORT' for kind in KINDS)}")
    address, _, query = rest.partition("?")
    if not address:
        raise SpecError(f"{text}: says no port; for example {name}:/dev/ttyUSB0, {name}:{AUTO}")
    kind = KINDS[name]
    options: dict[str, Any] = {}
    for part in filter(None, query.split("&")):
        key, _, value = part.partition("=")
        if key not in kind.options:
            raise SpecError(f"{text}: {name} has no option {key!r}; it has {', '.join(kind.options)}")
        try:
            options[key] = kind.options[key](unquote(value))
        except ValueError as error:
            raise SpecError(f"{text}: {key}={value}: {error}") from error
    missing = [key for key in kind.needed if key not in options]
    if missing:
        raise SpecError(
            f"{text}: {name} needs {', '.join(missing)}; for example "
            f"{name}:{address}?wheel_radius=0.0325&ticks=1440&track=0.2"
        )
    return DeviceSpec(name, address, options, text)
