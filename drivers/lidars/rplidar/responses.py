"""Responses of an RPLIDAR: a descriptor of 7 bytes, followed by one payload, or by packets of fixed size until it is
stopped.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar

from ...errors import DriverError

SYNC = b"\xa5\x5a"
DESCRIPTOR_SIZE = 7
MAX_RESPONSE_SIZE = 1024
"""Bytes; no single response is longer."""


class ResponseType(IntEnum):
    """Types of responses."""

    INFO = 0x04
    HEALTH = 0x06
    SAMPLE_RATE = 0x15
    CONFIGURATION = 0x20
    SET_CONFIGURATION = 0x21
    STANDARD = 0x81
    EXPRESS = 0x82
    HQ = 0x83
    ULTRA = 0x84
    DENSE = 0x85
    ULTRA_DENSE = 0x86
    MOTOR_BOARD = 0xFF


@dataclass(frozen=True, slots=True)
class Descriptor:
    """Announcement of the following data: `size` bytes of `type`, once or, if `multiple`, repeatedly."""

    size: int
    multiple: bool
    type: int

    def packet(self) -> bytes:
        """Return the bytes that the device sends: the length has 30 bits, the two above it are the mode."""
        return SYNC + struct.pack("<IB", self.size | (self.multiple << 30), self.type)

    @classmethod
    def parse(cls, packet: bytes) -> Descriptor:
        """Parse 7 bytes; raises DriverError if they are no descriptor."""
        if len(packet) != DESCRIPTOR_SIZE or packet[:2] != SYNC or packet[5] >> 6 > 1:
            raise DriverError(f"no response descriptor: {packet[:16].hex(' ')}")
        word, kind = struct.unpack("<IB", packet[2:])
        return cls(word & 0x3FFFFFFF, bool(word >> 30), kind)


class ResponseReader:
    """Search for one response in bytes that may begin with anything, such as a running scan or a banner.

    type      of the response
    size      of its payload, None if it varies
    multiple  True if packets follow until the device is stopped; then only the descriptor is searched
    prefix    beginning of the payload, such as the echo of the request; other responses are skipped

    Once the response is found, `remainder` holds the bytes after it.
    """

    def __init__(self, type: int, size: int | None = None, multiple: bool = False, prefix: bytes = b"") -> None:
        self.type, self.size, self.multiple, self.prefix = type, size, multiple, prefix
        self.bytes_skipped = 0
        self.remainder = b""
        self._held = b""
        self._payload: bytes | None = None

    def feed(self, data: bytes) -> bytes | None:
        """Return the response's payload, empty for a scan, as soon as it is complete; None before."""
        if self._payload is not None:
            self.remainder += data
            return self._payload
        self._held += data
        while (size := self._find_descriptor()) is not None and len(self._held) >= DESCRIPTOR_SIZE + size:
            end = DESCRIPTOR_SIZE + size
            payload = self._held[DESCRIPTOR_SIZE:end]
            if not payload.startswith(self.prefix):
                self._skip(1)
                continue
            self._payload, self.remainder, self._held = payload, self._held[end:], b""
            return payload
        return None

    def _find_descriptor(self) -> int | None:
        """Skip the bytes before a matching descriptor and return the length of its payload; None if there is none."""
        at = self._held.find(SYNC)
        while at >= 0 and at + DESCRIPTOR_SIZE <= len(self._held):
            if (size := self._payload_size(self._held[at : at + DESCRIPTOR_SIZE])) is not None:
                self._skip(at)
                return size
            at = self._held.find(SYNC, at + 1)
        # The last bytes may be the beginning of a descriptor.
        self._skip(at if at >= 0 else len(self._held) - self._held.endswith(SYNC[:1]))
        return None

    def _payload_size(self, packet: bytes) -> int | None:
        """Return the payload length that a descriptor announces; None if it is not the expected one."""
        try:
            descriptor = Descriptor.parse(packet)
        except DriverError:
            return None
        if descriptor.type != self.type or descriptor.multiple != self.multiple:
            return None
        if (self.size is not None and descriptor.size != self.size) or descriptor.size > MAX_RESPONSE_SIZE:
            return None
        return 0 if self.multiple else descriptor.size

    def _skip(self, count: int) -> None:
        self.bytes_skipped += count
        self._held = self._held[count:]


@dataclass(frozen=True, slots=True)
class Info:
    """Identity: model (see `models`), firmware as (major, minor), hardware revision, and serial number in hexadecimal
    in wire order.
    """

    model: int
    firmware: tuple[int, int]
    hardware: int
    serial: str

    SIZE: ClassVar[int] = 20

    @classmethod
    def parse(cls, payload: bytes) -> Info:
        """Parse 20 bytes; raises DriverError if the length is wrong."""
        model, minor, major, hardware, serial = _unpack("<BBBB16s", payload, "identity")
        return cls(model, (major, minor), hardware, serial.hex().upper())

    def payload(self) -> bytes:
        """Return the bytes that the device sends."""
        return struct.pack("<BBBB16s", self.model, *self.firmware[::-1], self.hardware, bytes.fromhex(self.serial))


class HealthStatus(IntEnum):
    """Status of the device; after an error it must be reset."""

    GOOD = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True, slots=True)
class Health:
    """Status and an error code; Slamtec does not document the codes."""

    status: HealthStatus
    code: int

    SIZE: ClassVar[int] = 3

    @classmethod
    def parse(cls, payload: bytes) -> Health:
        """Parse 3 bytes; raises DriverError if the length is wrong or the status is unknown."""
        status, code = _unpack("<BH", payload, "health")
        if status not in list(HealthStatus):
            raise DriverError(f"health status {status} is unknown")
        return cls(HealthStatus(status), code)

    def payload(self) -> bytes:
        """Return the bytes that the device sends."""
        return struct.pack("<BH", self.status, self.code)


@dataclass(frozen=True, slots=True)
class SampleRate:
    """Seconds between samples in standard and in express mode, of firmware without scan modes."""

    standard: float
    express: float

    SIZE: ClassVar[int] = 4

    @classmethod
    def parse(cls, payload: bytes) -> SampleRate:
        """Parse 4 bytes; raises DriverError if the length is wrong or a period is 0."""
        standard, express = _unpack("<HH", payload, "sample rate")
        if not (standard and express):
            raise DriverError("sample period is zero")
        return cls(standard / 1e6, express / 1e6)

    def payload(self) -> bytes:
        """Return the bytes that the device sends."""
        return struct.pack("<HH", round(self.standard * 1e6), round(self.express * 1e6))


DEFAULT_SAMPLE_RATE = SampleRate(476e-6, 476e-6)
"""Sample rate of firmware before 1.17, which does not report it."""


def has_motor_pwm(payload: bytes) -> bool:
    """Return whether the adapter board of an A2 or A3 drives the motor, from the response to GET_MOTOR_BOARD."""
    (flags,) = _unpack("<I", payload, "motor board")
    return bool(flags & 1)


def _unpack(format: str, payload: bytes, what: str) -> tuple[Any, ...]:
    if len(payload) != struct.calcsize(format):
        raise DriverError(f"{what} has {len(payload)} bytes, not {struct.calcsize(format)}")
    return struct.unpack(format, payload)
