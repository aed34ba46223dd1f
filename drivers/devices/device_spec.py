"""Device specs, the text a user types for a device: `rplidar:/dev/ttyUSB0?mode=Standard&mount=0.1,0,0`.

A spec consists of a kind, an address and options. Addresses:

    /dev/ttyUSB0         a serial port
    192.168.0.10:10940   host:port, raw bytes over TCP
    auto                 any serial port on which such a device responds
    tape:FILE            a byte capture, played at its original speed

Several devices are joined by a plus sign between spaces.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import unquote

import numpy as np

from ..errors import DriverError
from .external_lidars import external_kinds, external_lidar

AUTO = "auto"
CAPTURE_PREFIX = "tape:"
TCP_PATTERN = re.compile(r"(?P<host>[^/:\[\]]+|\[[0-9a-fA-F:]+\]):(?P<port>[0-9]{1,5})")


class SpecError(DriverError):
    """A device spec is wrong; the message states what is allowed."""


@dataclass(frozen=True, slots=True)
class DeviceSpec:
    """A parsed device spec: kind, address, converted options, and the text typed."""

    kind: str
    address: str
    options: Mapping[str, Any]
    text: str

    @property
    def is_lidar(self) -> bool:
        """True for a lidar, False for a wheel base."""
        return self.kind not in DEVICE_KINDS or DEVICE_KINDS[self.kind].is_lidar

    @property
    def tcp(self) -> tuple[str, int] | None:
        """Host and port if the device is behind a network, otherwise None."""
        match = TCP_PATTERN.fullmatch(self.address)
        return (match["host"].strip("[]"), int(match["port"])) if match else None


@dataclass(frozen=True, slots=True)
class Option:
    """An option of a device spec: conversion from its text to its value, and its description."""

    convert: Callable[[str], Any]
    description: str


@dataclass(frozen=True, slots=True)
class DeviceKind:
    """A kind of device: whether it is a lidar, its options, the required ones, and a description of the devices."""

    is_lidar: bool
    options: Mapping[str, Option]
    required: tuple[str, ...] = ()
    description: str = ""


def _parse_numbers(count: int) -> Callable[[str], Any]:
    def convert(text: str) -> Any:
        values = [float(part) for part in text.split(",")]
        if len(values) != count or not all(map(math.isfinite, values)):
            raise ValueError(f"{count} numbers with commas are needed")
        return np.array(values)

    return convert


def _parse_pair(text: str) -> tuple[float, float]:
    """Parse the values of the left and the right wheel; one number applies to both."""
    values = [float(part) for part in text.split(",")]
    if len(values) not in (1, 2) or not all(math.isfinite(value) and value != 0.0 for value in values):
        raise ValueError("one number, or the left and the right wheel's with a comma, is needed")
    return values[0], values[-1]


def _parse_positive(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError("a number above 0 is needed")
    return value


def _parse_positive_int(text: str) -> int:
    value = int(text)
    if value <= 0:
        raise ValueError("a whole number above 0 is needed")
    return value


def _parse_flag(text: str) -> bool:
    if text not in ("0", "1"):
        raise ValueError("1 (yes) or 0 (no) is needed")
    return text == "1"


def _parse_text(text: str) -> str:
    if not text:
        raise ValueError("it is empty")
    return text


COMMON_OPTIONS = {
    "baud": Option(_parse_positive_int, "bits per second, if not the usual"),
    "tape": Option(_parse_text, "a file for the byte capture: all raw bytes with their times"),
}
LIDAR_OPTIONS = COMMON_OPTIONS | {
    "mount": Option(
        _parse_numbers(3),
        "x,y,heading of the lidar's frame on the base, metres and radians: x points to the device's angle 0, "
        "y to its left",
    ),
    "upside_down": Option(_parse_flag, "1 if the lidar is mounted upside down"),
    "range_min": Option(_parse_positive, "metres; nearer measurements count as no return"),
    "range_max": Option(_parse_positive, "metres; farther measurements count as no return"),
}
MODE_OPTION = Option(_parse_text, "the name of a scan mode; the error for a wrong name lists the modes")
STRAY_OPTION = Option(_parse_flag, "0 keeps weak points that belong to no surface; LD06 and LD19 only")
SERIAL_OPTION = Option(_parse_text, "accept only the device with this serial number")
WHEEL_OPTIONS = COMMON_OPTIONS | {
    "wheel_radius": Option(_parse_pair, "metres; `0.0331,0.0329` if left and right differ"),
    "ticks": Option(
        _parse_pair,
        "encoder counts per turn of a wheel; negative if they count backwards; left and right may differ",
    ),
    "track": Option(_parse_positive, "metres between the wheels"),
    "top_speed": Option(_parse_positive, "m/s of a wheel; higher speeds count as transmission errors"),
    "bits": Option(_parse_positive_int, "number of bits of the encoder counters"),
    "dtr": Option(_parse_flag, "1 or 0: state of the modem line DTR. Boards with native USB send nothing without it"),
}
GEOMETRY_OPTIONS = ("wheel_radius", "ticks", "track")

DEVICE_KINDS: dict[str, DeviceKind] = {
    "rplidar": DeviceKind(
        True,
        LIDAR_OPTIONS | {"mode": MODE_OPTION, "serial": SERIAL_OPTION},
        description="all RPLIDARs: A1 to A3, S1 to S3, C1. The baud rate is detected; "
        "the scan mode is the device's typical one",
    ),
    "ld06": DeviceKind(
        True,
        LIDAR_OPTIONS | {"stray_filter": STRAY_OPTION},
        description="LDROBOT LD06, LD19 and STL-27L. The baud rate is detected",
    ),
    "scip": DeviceKind(
        True,
        LIDAR_OPTIONS | {"mode": MODE_OPTION, "serial": SERIAL_OPTION},
        description="Hokuyo's lidars with SCIP 2.0. Scan modes: `distance`, the default; `intensity`; `last` and "
        "`strongest` use that one of several echoes of a beam",
    ),
    "create2": DeviceKind(False, WHEEL_OPTIONS, description="iRobot Create 2, Roomba from the 500 series on"),
    "kobuki": DeviceKind(False, WHEEL_OPTIONS, description="Kobuki; its gyro's heading is used"),
    "arduino": DeviceKind(False, WHEEL_OPTIONS, GEOMETRY_OPTIONS, description="ros_arduino_bridge"),
    "wheels": DeviceKind(
        False, WHEEL_OPTIONS, GEOMETRY_OPTIONS, description="self-made bases with the project's line protocol"
    ),
}
"""Kinds of devices of this package, by the name that a user types."""


def is_device_spec(text: str) -> bool:
    """Return True if a text names devices rather than a recording."""
    name, colon, _ = text.partition(":")
    return bool(colon) and (name.strip() in DEVICE_KINDS or name.strip() in external_kinds())


def _kind(name: str) -> DeviceKind | None:
    """Return the kind of device with this name, also of another package; None if there is none.

    Raises DriverError if the driver of another package cannot be used.
    """
    if name in DEVICE_KINDS:
        return DEVICE_KINDS[name]
    driver = external_lidar(name)
    return None if driver is None else DeviceKind(True, {**LIDAR_OPTIONS, **driver.own_options})


def parse_devices(text: str) -> list[DeviceSpec]:
    """Parse the devices in a text such as `rplidar:/dev/ttyUSB0 + create2:/dev/ttyUSB1`; raises SpecError."""
    specs = [parse_device(part) for part in re.split(r"\s+\+\s+", text.strip())]
    addresses = [spec.address for spec in specs if spec.address != AUTO]
    for address in addresses:
        if addresses.count(address) > 1:
            raise SpecError(f"{text}: {address} is used twice")
    return specs


def check_robot(specs: Sequence[DeviceSpec]) -> None:
    """Raise SpecError if devices cannot be those of one robot, which has up to two lidars and one wheel base."""
    for kind, most, devices in (
        ("lidars", 2, [spec.text for spec in specs if spec.is_lidar]),
        ("wheel bases", 1, [spec.text for spec in specs if not spec.is_lidar]),
    ):
        if len(devices) > most:
            raise SpecError(f"{' + '.join(devices)}: {len(devices)} {kind} are given, and at most {most} can be used")


def parse_device(text: str) -> DeviceSpec:
    """Parse the spec of one device; raises SpecError if it is wrong."""
    text = text.strip()
    name, colon, rest = text.partition(":")
    kind = _kind(name) if colon else None
    if kind is None:
        known = ", ".join(f"{known}:PORT" for known in (*DEVICE_KINDS, *external_kinds()))
        others = "; other lidars can be used by wclm ros, if they have a driver for ROS 2" if colon else ""
        raise SpecError(f"{text}: not a device; there are {known}{others}")
    address, _, query = rest.partition("?")
    if not address:
        raise SpecError(f"{text}: the port is missing; for example {name}:/dev/ttyUSB0, {name}:{AUTO}")
    options: dict[str, Any] = {}
    for part in filter(None, query.split("&")):
        key, _, value = part.partition("=")
        if key not in kind.options:
            raise SpecError(f"{text}: {name} has no option {key!r}; it has {', '.join(kind.options)}")
        try:
            options[key] = kind.options[key].convert(unquote(value))
        except ValueError as error:
            raise SpecError(f"{text}: {key}={value}: {error}") from error
    missing = [key for key in kind.required if key not in options]
    if missing:
        raise SpecError(
            f"{text}: {name} needs {', '.join(missing)}; for example "
            f"{name}:{address}?wheel_radius=0.0325&ticks=1440&track=0.2"
        )
    return DeviceSpec(name, address, options, text)
