"""iRobot Create 2 and Roomba from the 500 series on: the Open Interface, big-endian.

The base sends its encoder counts (packets 43 and 44) every 15 ms as `13 06 2B hi lo 2C hi lo chk`. The sum of all bytes
is zero modulo 256; by the manual's older wording it is the sum of the bytes after the first. Both are taken, and the
one that was met is kept to. The packets carry no time: their count stands in, with those that the skipped bytes were.
"""

from __future__ import annotations

import struct
from typing import ClassVar

from .framing import Frames
from .interface import Counters, Request, Stream, Velocity, WheelReading
from .kinematics import DifferentialDrive

START, SAFE, FULL, DRIVE_DIRECT, STREAM, PAUSE, STOP = 128, 131, 132, 145, 148, 150, 173
LEFT_COUNT, RIGHT_COUNT = 43, 44
PACKETS = bytes([2, LEFT_COUNT, RIGHT_COUNT])
HEADER = bytes([19, 6, LEFT_COUNT])
FRAME = struct.Struct(">3sHBHB")
RELOCK = 3
"""Frames in a row that are right by the other checksum before that one is kept to."""

WHEELS = DifferentialDrive(left=0.444565e-3, right=0.444565e-3, track=0.235, bits=16, top_speed=0.5)
"""508.8 counts a revolution of a 72 mm wheel."""


class Create2:
    """The host's side; see `WheelBase`."""

    name: ClassVar[str] = "create2"
    baud: ClassVar[int] = 115200
    tick: ClassVar[float | None] = 0.015
    wraps_at: ClassVar[int | None] = None
    poll_period: ClassVar[float | None] = None

    def __init__(self, wheels: DifferentialDrive = WHEELS) -> None:
        self.wheels, self.counters = wheels, Counters()
        self._frames = Frames(HEADER, lambda _: FRAME.size, self._valid, self.counters)
        self._rest: int | None = None  # what all bytes of an undamaged frame sum up to
        self._others = 0  # frames in a row that summed up to the other rest
        self._time = 0
        self._skipped = 0  # until the last frame

    def start(self) -> bytes:
        """Safe mode, in which the base drives but stops at cliffs, and the stream of counts."""
        return bytes([START, SAFE, STREAM]) + PACKETS

    def poll(self) -> bytes:
        """Nothing: the base streams."""
        return b""

    def drive(self, velocity: Velocity) -> bytes:
        """The wheels' speeds in mm/s, the right one first."""
        left, right = self.wheels.wheel_speeds(velocity.speed, velocity.turn_rate)
        return struct.pack(">Bhh", DRIVE_DIRECT, round(1000 * right), round(1000 * left))

    def stop(self) -> bytes:
        """Stand, end the stream, and leave the interface, without which the base drains its battery awake."""
        return self.drive(Velocity(0.0, 0.0)) + bytes([PAUSE, 0, STOP])

    def feed(self, chunk: bytes) -> list[WheelReading]:
        """The readings that a chunk completes."""
        readings = []
        for frame in self._frames.feed(chunk):
            self.counters.good += 1
            _, left, _, right, _ = FRAME.unpack(frame)
            if self.counters.good > 1:
                missed = round((self.counters.skipped - self._skipped) / FRAME.size)
                self._time += 1 + missed
                self.counters.lost += missed
            self._skipped = self.counters.skipped
            readings.append(WheelReading(left, right, self._time))
        return readings

    def _valid(self, frame: bytes) -> bool:
        rest = sum(frame) % 256
        if frame[5] != RIGHT_COUNT or rest not in (0, HEADER[0]):
            return False
        if rest == self._rest or self._rest is None:
            self._rest, self._others = rest, 0
            return True
        self._others += 1
        if self._others < RELOCK:
            return False
        self._rest, self._others = rest, 0
        return True


class Create2Device:
    """The base's side; see `WheelDevice`. Drives in safe and full mode only, and does nothing before it is started."""

    ARGUMENTS: ClassVar[dict[int, int]] = {START: 0, SAFE: 0, FULL: 0, DRIVE_DIRECT: 4, PAUSE: 1, STOP: 0}

    def __init__(self, wheels: DifferentialDrive = WHEELS) -> None:
        self.counters = Counters()
        self._wheels = wheels
        self._buffer = bytearray()
        self._mode = STOP

    def encode(self, reading: WheelReading) -> bytes:
        """One frame of the stream."""
        body = FRAME.pack(HEADER, reading.left % 65536, RIGHT_COUNT, reading.right % 65536, 0)
        return body[:-1] + bytes([-sum(body) % 256])

    def feed(self, chunk: bytes) -> list[Request]:
        """The requests that a chunk completes."""
        self._buffer += chunk
        requests: list[Request] = []
        while self._buffer:
            opcode = self._buffer[0]
            size = 1 + self._arguments()
            if len(self._buffer) < size:
                break
            arguments = bytes(self._buffer[1:size])
            del self._buffer[:size]
            request = self._request(opcode, arguments)
            if request is not None:
                requests.append(request)
                self.counters.good += 1
        return requests

    def _arguments(self) -> int:
        """The number of bytes after the opcode at the buffer's start."""
        if self._buffer[0] == STREAM:
            return 1 + (self._buffer[1] if len(self._buffer) > 1 else 0)
        return self.ARGUMENTS.get(self._buffer[0], 0)

    def _request(self, opcode: int, arguments: bytes) -> Request | None:
        if opcode not in self.ARGUMENTS and opcode != STREAM:
            self.counters.skipped += 1
        elif opcode == START or (self._mode != STOP and opcode in (SAFE, FULL, STOP)):
            self._mode = opcode
            return Stream(False) if opcode == STOP else None
        elif opcode == STREAM and self._mode != STOP:
            return Stream(arguments == PACKETS)
        elif opcode == PAUSE and self._mode != STOP:
            return Stream(arguments == b"\x01")
        elif opcode == DRIVE_DIRECT and self._mode in (SAFE, FULL):
            right, left = (speed / 1000 for speed in struct.unpack(">hh", arguments))
            return Velocity((right + left) / 2, (right - left) / self._wheels.track)
        return None
