"""Protocol of iRobot Create 2 and Roomba from the 500 series on: the Open Interface, big-endian.

The base sends its encoder counts (packets 43 and 44) every 15 ms as `13 06 2B hi lo 2C hi lo chk`. The sum of all bytes
is zero modulo 256; according to older manuals it is the sum of the bytes after the first. Both variants are accepted,
and the first one received is expected from then on. The packets contain no time: it is counted in frames, including
lost frames estimated from the number of skipped bytes.
"""

from __future__ import annotations

import struct
from typing import ClassVar

from .framing import FrameParser
from .interface import ParserCounters, Request, Stream, Velocity, WheelReading
from .kinematics import DifferentialDrive

START, SAFE, FULL, DRIVE_DIRECT, STREAM, PAUSE, STOP = 128, 131, 132, 145, 148, 150, 173
LEFT_COUNT, RIGHT_COUNT = 43, 44
STREAMED_PACKETS = bytes([2, LEFT_COUNT, RIGHT_COUNT])
HEADER = bytes([19, 6, LEFT_COUNT])
FRAME = struct.Struct(">3sHBHB")
CHECKSUM_CHANGE_FRAMES = 3
"""Consecutive frames with the other checksum variant after which that one is expected."""

WHEEL_RADIUS = 0.036
"""Metres."""
WHEELS = DifferentialDrive(left=0.444565e-3, right=0.444565e-3, track=0.235, bits=16, top_speed=0.5)
"""508.8 counts per revolution of a 72 mm wheel."""


class Create2:
    """Host's side of the protocol, see `WheelBase`."""

    name: ClassVar[str] = "create2"
    baud: ClassVar[int] = 115200
    tick: ClassVar[float | None] = 0.015
    wraps_at: ClassVar[int | None] = None
    poll_period: ClassVar[float | None] = None

    def __init__(self, wheels: DifferentialDrive = WHEELS) -> None:
        self.wheels, self.counters = wheels, ParserCounters()
        self._frames = FrameParser(HEADER, lambda _: FRAME.size, self._valid, self.counters)
        self._checksum: int | None = None  # sum of all bytes of an undamaged frame, modulo 256
        self._other_checksums = 0  # consecutive frames with the other checksum
        self._time = 0
        self._skipped = 0  # bytes skipped until the last frame

    def start(self) -> bytes:
        """Return the commands for passive mode, in which the base obeys its buttons, and for the stream of counts."""
        return bytes([START, STREAM]) + STREAMED_PACKETS

    def poll(self) -> bytes:
        """Return nothing: the base streams."""
        return b""

    def enable_driving(self) -> bytes:
        """Return the command for safe mode: the base drives, but returns to passive mode at a cliff, if a wheel drops,
        and on the charger.
        """
        return bytes([SAFE])

    def drive(self, velocity: Velocity) -> bytes:
        """Return the command with the wheels' speeds in mm/s, the right one first."""
        left, right = self.wheels.wheel_speeds(velocity.speed, velocity.turn_rate)
        return struct.pack(">Bhh", DRIVE_DIRECT, round(1000 * right), round(1000 * left))

    def end(self) -> bytes:
        """Return the commands to end the stream, and to leave the interface, so that the base can sleep."""
        return bytes([PAUSE, 0, STOP])

    def feed(self, chunk: bytes) -> list[WheelReading]:
        """Return the readings that a chunk completes."""
        readings = []
        for frame in self._frames.feed(chunk):
            self.counters.good += 1
            _, left, _, right, _ = FRAME.unpack(frame)
            if self.counters.good > 1:
                lost = round((self.counters.skipped - self._skipped) / FRAME.size)
                self._time += 1 + lost
                self.counters.lost += lost
            self._skipped = self.counters.skipped
            readings.append(WheelReading(left, right, self._time))
        return readings

    def _valid(self, frame: bytes) -> bool:
        checksum = sum(frame) % 256
        if frame[5] != RIGHT_COUNT or checksum not in (0, HEADER[0]):
            return False
        if checksum == self._checksum or self._checksum is None:
            self._checksum, self._other_checksums = checksum, 0
            return True
        self._other_checksums += 1
        if self._other_checksums < CHECKSUM_CHANGE_FRAMES:
            return False
        self._checksum, self._other_checksums = checksum, 0
        return True


class Create2Device:
    """Device's side of the protocol, see `WheelDevice`. It drives in safe and full mode, and stops on leaving them."""

    ARGUMENTS: ClassVar[dict[int, int]] = {START: 0, SAFE: 0, FULL: 0, DRIVE_DIRECT: 4, PAUSE: 1, STOP: 0}

    def __init__(self, wheels: DifferentialDrive = WHEELS) -> None:
        self.counters = ParserCounters()
        self._wheels = wheels
        self._buffer = bytearray()
        self._mode = STOP

    def encode(self, reading: WheelReading) -> bytes:
        """Return one frame of the stream."""
        body = FRAME.pack(HEADER, reading.left % 65536, RIGHT_COUNT, reading.right % 65536, 0)
        return body[:-1] + bytes([-sum(body) % 256])

    def feed(self, chunk: bytes) -> list[Request]:
        """Return the requests that a chunk completes."""
        self._buffer += chunk
        requests: list[Request] = []
        while self._buffer:
            opcode = self._buffer[0]
            size = 1 + self._arguments()
            if len(self._buffer) < size:
                break
            arguments = bytes(self._buffer[1:size])
            del self._buffer[:size]
            understood = self._requests(opcode, arguments)
            requests += understood
            self.counters.good += len(understood)
        return requests

    def _arguments(self) -> int:
        """Return the number of bytes after the opcode at the beginning of the buffer."""
        if self._buffer[0] == STREAM:
            return 1 + (self._buffer[1] if len(self._buffer) > 1 else 0)
        return self.ARGUMENTS.get(self._buffer[0], 0)

    def _requests(self, opcode: int, arguments: bytes) -> list[Request]:
        if opcode not in self.ARGUMENTS and opcode != STREAM:
            self.counters.skipped += 1
        elif opcode == START or (self._mode != STOP and opcode in (SAFE, FULL, STOP)):
            stopped = [Velocity(0.0, 0.0)] if self._mode in (SAFE, FULL) and opcode in (START, STOP) else []
            self._mode = opcode
            return [*stopped, Stream(False)] if opcode == STOP else [*stopped]
        elif opcode == STREAM and self._mode != STOP:
            return [Stream(arguments == STREAMED_PACKETS)]
        elif opcode == PAUSE and self._mode != STOP:
            return [Stream(arguments == b"\x01")]
        elif opcode == DRIVE_DIRECT and self._mode in (SAFE, FULL):
            right, left = (speed / 1000 for speed in struct.unpack(">hh", arguments))
            return [Velocity((right + left) / 2, (right - left) / self._wheels.track)]
        return []
