"""Kobuki (TurtleBot 2): binary packets in both directions, little-endian, `AA 55 length payload chk`.

chk is the exclusive or of the length and the payload. A payload is a row of parts `id length data`. The base sends 50
packets a second by itself; part 1 has the time, the encoders and the battery, part 4 the gyro's heading.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from functools import reduce
from operator import xor
from typing import ClassVar

from ..se2 import wrap
from .framing import Frames
from .interface import Counters, Request, Velocity, WheelReading
from .kinematics import DifferentialDrive

HEADER = b"\xaa\x55"
CORE, INERTIA = 1, 4
CORE_DATA = struct.Struct("<H3xHHbb2xBx")
"""Time in ms, [bumper, wheel drop, cliff], left and right count, left and right PWM, [buttons, charger], battery in
0.1 V, [overcurrent]."""
INERTIA_DATA = struct.Struct("<hh3x")
"""Heading in 0.01 degrees and turn rate in 0.01 degrees per second, counter-clockwise."""
BASE_CONTROL = 1
BASE_CONTROL_DATA = struct.Struct("<hh")
"""Speed of the outer wheel in mm/s, radius of the arc in mm: 0 goes straight, 1 spins."""
LEAST_PAYLOAD, LARGEST_PAYLOAD = 3, 160
"""Bytes: a part with one byte of data; more than all parts that the base ever sends together, which is about 130."""
LARGEST_RADIUS = 32767
"""mm; a larger arc is driven straight."""

METRES_PER_COUNT = 0.035 * 0.0024369169
"""The wheel's radius times radians a count."""
WHEELS = DifferentialDrive(left=METRES_PER_COUNT, right=METRES_PER_COUNT, track=0.230, bits=16, top_speed=0.7)


def frames(counters: Counters) -> Frames:
    """Finds packets of either direction."""

    return Frames(HEADER, _size, lambda frame: reduce(xor, frame[2:]) == 0, counters)


def _size(buffer: bytearray) -> int:
    """See `Frames`. Parts that do not fill the payload show a wrong length long before so many bytes have come, and
    lost bytes that the checksum misses.
    """
    if len(buffer) < 3:
        return 0
    part, end = 3, 3 + buffer[2]
    while part + 1 < min(end, len(buffer)):
        part += 2 + buffer[part + 1]
    wrong = part > end or part == end - 1 or not LEAST_PAYLOAD <= buffer[2] <= LARGEST_PAYLOAD
    return -1 if wrong else end + 1


def packet(*contents: tuple[int, bytes]) -> bytes:
    """A packet with parts (id, data)."""
    payload = b"".join(bytes([kind, len(data)]) + data for kind, data in contents)
    body = bytes([len(payload)]) + payload
    return HEADER + body + bytes([reduce(xor, body)])


def parts(frame: bytes) -> Iterator[tuple[int, bytes]]:
    """The parts (id, data) of a packet."""
    payload = frame[3:-1]
    while payload:
        yield payload[0], payload[2 : 2 + payload[1]]
        payload = payload[2 + payload[1] :]


class Kobuki:
    """The host's side; see `WheelBase`."""

    name: ClassVar[str] = "kobuki"
    baud: ClassVar[int] = 115200
    tick: ClassVar[float | None] = 0.001
    wraps_at: ClassVar[int | None] = 65536
    poll_period: ClassVar[float | None] = None

    def __init__(self, wheels: DifferentialDrive = WHEELS) -> None:
        self.wheels, self.counters = wheels, Counters()
        self._frames = frames(self.counters)

    def start(self) -> bytes:
        """A command to stand: the base sends anyhow."""
        return self.drive(Velocity(0.0, 0.0))

    def poll(self) -> bytes:
        """Nothing: the base sends by itself."""
        return b""

    def drive(self, velocity: Velocity) -> bytes:
        """The outer wheel's speed and the radius of the arc."""
        left, right = (1000 * speed for speed in self.wheels.wheel_speeds(velocity.speed, velocity.turn_rate))
        half = 500 * self.wheels.track
        speed, radius = (left + right) / 2, 0
        if left != right:
            arc = half * (right + left) / (right - left)
            if abs(arc) <= LARGEST_RADIUS:
                radius = _radius(arc)
                outer = right if abs(right) >= abs(left) else left
                speed = outer if radius != 1 else (right - left) / 2
        return packet((BASE_CONTROL, BASE_CONTROL_DATA.pack(round(speed), radius)))

    def stop(self) -> bytes:
        """Stand; the base cannot be silenced."""
        return self.drive(Velocity(0.0, 0.0))

    def feed(self, chunk: bytes) -> list[WheelReading]:
        """The readings that a chunk completes; packets without the core part tell none."""
        readings = []
        for frame in self._frames.feed(chunk):
            sizes = {CORE: CORE_DATA.size, INERTIA: INERTIA_DATA.size}
            found = {kind: data for kind, data in parts(frame) if len(data) == sizes.get(kind)}
            if CORE in found:
                self.counters.good += 1
                readings.append(_reading(found[CORE], found.get(INERTIA)))
        return readings


def _radius(arc: float) -> int:
    """The radius (mm) to order for an arc: 1 is kept for a spin, so no arc has it; the nearest that is left."""
    if abs(arc) < 1:
        return 1
    return round(math.copysign(max(2.0, abs(arc)), arc))


def _reading(core: bytes, inertia: bytes | None) -> WheelReading:
    time, left, right, _, _, battery = CORE_DATA.unpack(core)
    heading = None
    if inertia is not None:
        heading = float(wrap(math.radians(INERTIA_DATA.unpack(inertia)[0] / 100)))
    return WheelReading(left, right, time, heading, battery / 10)


class KobukiDevice:
    """The base's side; see `WheelDevice`."""

    def __init__(self, wheels: DifferentialDrive = WHEELS) -> None:
        self.counters = Counters()
        self._half = wheels.track / 2
        self._frames = frames(self.counters)

    def encode(self, reading: WheelReading) -> bytes:
        """One packet, with a gyro's part where the reading has a heading."""
        battery = round(10 * (reading.battery or 0.0))
        time = (reading.time or 0) % 65536
        core = (CORE, CORE_DATA.pack(time, reading.left % 65536, reading.right % 65536, 0, 0, battery))
        if reading.heading is None:
            return packet(core)
        return packet(core, (INERTIA, INERTIA_DATA.pack(round(100 * math.degrees(reading.heading)), 0)))

    def feed(self, chunk: bytes) -> list[Request]:
        """The requests that a chunk completes."""
        requests: list[Request] = []
        for frame in self._frames.feed(chunk):
            for kind, data in parts(frame):
                if kind == BASE_CONTROL and len(data) == BASE_CONTROL_DATA.size:
                    self.counters.good += 1
                    requests.append(self._velocity(*BASE_CONTROL_DATA.unpack(data)))
        return requests

    def _velocity(self, outer: int, radius: int) -> Velocity:
        """The velocity that the speed of the outer wheel (mm/s) on an arc (mm) makes."""
        speed, arc = outer / 1000, radius / 1000
        if radius == 0:
            return Velocity(speed, 0.0)
        if radius == 1:
            return Velocity(0.0, speed / self._half)
        turn_rate = speed / (arc + math.copysign(self._half, arc))
        return Velocity(arc * turn_rate, turn_rate)
