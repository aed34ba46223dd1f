"""Requests to an RPLIDAR: A5 and a command, or A5, command, length, payload and the XOR of all these bytes."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from functools import reduce
from operator import xor

SYNC = 0xA5
HAS_PAYLOAD = 0x80
"""Bit of the command that marks a payload."""


class Command(IntEnum):
    """Commands. Those without a response take effect at once; the response to a scan does not end."""

    STOP = 0x25
    RESET = 0x40
    SCAN = 0x20
    FORCE_SCAN = 0x21
    GET_INFO = 0x50
    GET_HEALTH = 0x52
    GET_SAMPLE_RATE = 0x59
    EXPRESS_SCAN = 0x82
    HQ_SCAN = 0x83
    GET_CONFIGURATION = 0x84
    SET_CONFIGURATION = 0x85
    CONFIRM_BAUD = 0x90
    SET_MOTOR_SPEED = 0xA8
    SET_MOTOR_PWM = 0xF0
    GET_MOTOR_BOARD = 0xFF


@dataclass(frozen=True, slots=True)
class Request:
    """A command with its payload, which is empty if the command takes none."""

    command: int
    payload: bytes = b""

    def packet(self) -> bytes:
        """Return the bytes to send."""
        if not self.command & HAS_PAYLOAD:
            return bytes([SYNC, self.command])
        packet = bytes([SYNC, self.command, len(self.payload)]) + self.payload
        return packet + bytes([reduce(xor, packet)])


STOP = Request(Command.STOP)
RESET = Request(Command.RESET)
SCAN = Request(Command.SCAN)
FORCE_SCAN = Request(Command.FORCE_SCAN)
GET_INFO = Request(Command.GET_INFO)
GET_HEALTH = Request(Command.GET_HEALTH)
GET_SAMPLE_RATE = Request(Command.GET_SAMPLE_RATE)
HQ_SCAN = Request(Command.HQ_SCAN, bytes(33))
GET_MOTOR_BOARD = Request(Command.GET_MOTOR_BOARD, bytes(4))


def express_scan(mode: int) -> Request:
    """Return the request that starts the scan mode `mode`; firmware without scan modes accepts only 0. Modes with the
    standard format start with SCAN instead.
    """
    return Request(Command.EXPRESS_SCAN, struct.pack("<BHH", mode, 0, 0))


def get_configuration(entry: int, mode: int | None = None) -> Request:
    """Return the request for an entry of the configuration (see `modes.ConfigEntry`), of one scan mode if it has one
    per mode.
    """
    payload = struct.pack("<I", entry) + (b"" if mode is None else struct.pack("<H", mode))
    return Request(Command.GET_CONFIGURATION, payload)


def set_motor_speed(revolutions_per_minute: int) -> Request:
    """Return the request to turn at a speed, for models with software control (S series)."""
    return Request(Command.SET_MOTOR_SPEED, struct.pack("<H", revolutions_per_minute))


def set_motor_pwm(duty: int) -> Request:
    """Return the request to drive the motor through the USB board of A2 and A3; 0 stops, 660 is usual, 1023 the
    maximum.
    """
    return Request(Command.SET_MOTOR_PWM, struct.pack("<H", duty))


class RequestReader:
    """The device's side: finds requests in bytes in any chunks. Other bytes are skipped and counted."""

    def __init__(self) -> None:
        self.bytes_skipped = 0
        self._held = b""

    def feed(self, data: bytes) -> list[Request]:
        """Return the requests that these bytes complete."""
        held, at = self._held + data, 0
        requests: list[Request] = []
        while at < len(held):
            length = self._length(held, at)
            if length is None or at + length > len(held):
                break
            packet = held[at : at + length]
            if length == 1 or (length > 2 and reduce(xor, packet) != 0):
                self.bytes_skipped += 1
                at += 1
                continue
            requests.append(Request(packet[1], packet[3:-1]))
            at += length
        self._held = held[at:]  # less than the longest request, 259 bytes
        return requests

    def _length(self, held: bytes, at: int) -> int | None:
        """Return the length of the request at a byte; 1 if there is none, None if more bytes are needed."""
        if held[at] != SYNC:
            return 1
        if at + 1 == len(held):
            return None
        if not held[at + 1] & HAS_PAYLOAD:
            return 2
        return held[at + 2] + 4 if at + 2 < len(held) else None
