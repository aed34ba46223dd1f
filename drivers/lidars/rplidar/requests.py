"""What the host sends to an RPLIDAR: A5 and a command, or A5, command, length, payload and the XOR of all these."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from functools import reduce
from operator import xor

SYNC = 0xA5
HAS_PAYLOAD = 0x80
"""Bit of the command."""


class Command(IntEnum):
    """What can be asked. Those without an answer take effect at once; a scan's answer does not end."""

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
    """A command with its payload, empty where the command takes none."""

    command: int
    payload: bytes = b""

    def packet(self) -> bytes:
        """The bytes to send."""
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
    """Start the scan mode of that id; firmware that tells no modes knows only 0. Not for modes that answer with the
    standard format: those start with SCAN.
    """
    return Request(Command.EXPRESS_SCAN, struct.pack("<BHH", mode, 0, 0))


def get_configuration(entry: int, mode: int | None = None) -> Request:
    """Ask for an entry of the configuration (see `modes.Entry`), of one scan mode where it has one for each."""
    payload = struct.pack("<I", entry) + (b"" if mode is None else struct.pack("<H", mode))
    return Request(Command.GET_CONFIGURATION, payload)


def set_motor_speed(revolutions_per_minute: int) -> Request:
    """Turn at that speed, where the model lets software set it (S series)."""
    return Request(Command.SET_MOTOR_SPEED, struct.pack("<H", revolutions_per_minute))


def set_motor_pwm(duty: int) -> Request:
    """Drive the motor through the USB board of A2 and A3; 0 stops, 660 is usual, 1023 the most."""
    return Request(Command.SET_MOTOR_PWM, struct.pack("<H", duty))


class RequestReader:
    """The device's ear: requests out of bytes in any chunks. What is no request is passed over and counted."""

    def __init__(self) -> None:
        self.bytes_skipped = 0
        self._held = b""

    def feed(self, data: bytes) -> list[Request]:
        """The requests that these bytes complete."""
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
        """Of the request at a byte; 1 where there is none, None where that cannot be said yet."""
        if held[at] != SYNC:
            return 1
        if at + 1 == len(held):
            return None
        if not held[at + 1] & HAS_PAYLOAD:
            return 2
        return held[at + 2] + 4 if at + 2 < len(held) else None
