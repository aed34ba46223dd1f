"""What an RPLIDAR answers: a descriptor of 7 bytes, then one payload, or packets of one size until it is stopped."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar

from ...errors import DriverError

SYNC = b"\xa5\x5a"
DESCRIPTOR_SIZE = 7
MAX_RESPONSE_SIZE = 1024
"""Bytes; no single answer is longer."""


class ResponseType(IntEnum):
    """Types of answers."""

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
    """Says what follows: `size` bytes of a `type`, once, or again and again where `multiple`."""

    size: int
    multiple: bool
    type: int

    def packet(self) -> bytes:
        """The bytes that the device sends: the length has 30 bits, the two above are the mode."""
        return SYNC + struct.pack("<IB", self.size | (self.multiple << 30), self.type)

    @classmethod
    def parse(cls, packet: bytes) -> Descriptor:
        """From its 7 bytes; raises DriverError where they are none."""
        if len(packet) != DESCRIPTOR_SIZE or packet[:2] != SYNC or packet[5] >> 6 > 1:
            raise DriverError(f"no answer descriptor: {packet[:16].hex(' ')}")
        word, kind = struct.unpack("<IB", packet[2:])
        return cls(word & 0x3FFFFFFF, bool(word >> 30), kind)


class ResponseReader:
    """Waits for one answer in bytes that may begin with anything: a scan that still runs, the banner after a reset.

    type      of the answer
    size      of its payload, None where it varies
    multiple  whether packets follow until the device is stopped; then only the descriptor is waited for
    prefix    what the payload begins with, as the echo of what was asked; other answers are passed over

    Once the answer is there, `rest` holds the bytes after it.
    """

    def __init__(self, type: int, size: int | None = None, multiple: bool = False, prefix: bytes = b"") -> None:
        self.type, self.size, self.multiple, self.prefix = type, size, multiple, prefix
        self.bytes_skipped = 0
        self.remainder = b""
        self._held = b""
        self._payload: bytes | None = None

    def feed(self, data: bytes) -> bytes | None:
        """The answer's payload, empty for a scan's, as soon as it is there; None before."""
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
        """Pass what comes before a fitting descriptor; the length of the payload after it, None where none is there."""
        at = self._held.find(SYNC)
        while at >= 0 and at + DESCRIPTOR_SIZE <= len(self._held):
            if (size := self._payload_size(self._held[at : at + DESCRIPTOR_SIZE])) is not None:
                self._skip(at)
                return size
            at = self._held.find(SYNC, at + 1)
        # The last bytes may begin a descriptor.
        self._skip(at if at >= 0 else len(self._held) - self._held.endswith(SYNC[:1]))
        return None

    def _payload_size(self, packet: bytes) -> int | None:
        """The length of the payload that a descriptor announces, None where it is not the one waited for."""
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
    """Who answers: model (see `models`), firmware as (major, minor), hardware revision, serial number in hexadecimal,
    in the order of the wire.
    """

    model: int
    firmware: tuple[int, int]
    hardware: int
    serial: str

    SIZE: ClassVar[int] = 20

    @classmethod
    def parse(cls, payload: bytes) -> Info:
        """From 20 bytes; raises DriverError where there are not as many."""
        model, minor, major, hardware, serial = _unpack("<BBBB16s", payload, "identity")
        return cls(model, (major, minor), hardware, serial.hex().upper())

    def payload(self) -> bytes:
        """The bytes that the device sends."""
        return struct.pack("<BBBB16s", self.model, *self.firmware[::-1], self.hardware, bytes.fromhex(self.serial))


class HealthStatus(IntEnum):
    """Of the device's health; after an error it must be reset."""

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
        """From 3 bytes; raises DriverError where there are not as many, or the status is none."""
        status, code = _unpack("<BH", payload, "health")
        if status not in list(HealthStatus):
            raise DriverError(f"health status {status} is unknown")
        return cls(HealthStatus(status), code)

    def payload(self) -> bytes:
        """The bytes that the device sends."""
        return struct.pack("<BH", self.status, self.code)


@dataclass(frozen=True, slots=True)
class SampleRate:
    """Seconds between samples in standard and in express mode, of firmware that tells no scan modes."""

    standard: float
    express: float

    SIZE: ClassVar[int] = 4

    @classmethod
    def parse(cls, payload: bytes) -> SampleRate:
        """From 4 bytes; raises DriverError where there are not as many, or a period is 0."""
        standard, express = _unpack("<HH", payload, "sample rate")
        if not (standard and express):
            raise DriverError("sample period is zero")
        return cls(standard / 1e6, express / 1e6)

    def payload(self) -> bytes:
        """The bytes that the device sends."""
        return struct.pack("<HH", round(self.standard * 1e6), round(self.express * 1e6))


DEFAULT_SAMPLE_RATE = SampleRate(476e-6, 476e-6)
"""Of firmware before 1.17, which cannot be asked."""


def has_motor_pwm(payload: bytes) -> bool:
    """Whether the board that A2 or A3 hangs on drives the motor, from the answer to GET_MOTOR_BOARD."""
    (flags,) = _unpack("<I", payload, "motor board")
    return bool(flags & 1)


def _unpack(format: str, payload: bytes, what: str) -> tuple[Any, ...]:
    if len(payload) != struct.calcsize(format):
        raise DriverError(f"{what} has {len(payload)} bytes, not {struct.calcsize(format)}")
    return struct.unpack(format, payload)
