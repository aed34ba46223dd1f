"""Protocol of Kobuki (TurtleBot 2): binary packets in both directions, little-endian, `AA 55 length payload chk`.

chk is the exclusive or of the length and the payload. A payload is a sequence of parts `id length data`. The base sends
50 packets per second without requests; part 1 contains time, encoders and battery, part 4 the gyro's heading.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from functools import reduce
from operator import xor
from typing import ClassVar

from ..se2 import wrap
from .framing import FrameParser
from .interface import ParserCounters, Request, Velocity, WheelReading
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
"""Speed of the outer wheel in mm/s, radius of the arc in mm: 0 is straight on, 1 is turning on the spot."""
MIN_PAYLOAD, MAX_PAYLOAD = 3, 160
"""Bytes: a part with one byte of data; more than all parts of the base together, about 130."""
MAX_RADIUS = 32767
"""mm; larger arcs are driven straight."""

WHEEL_RADIUS = 0.035
"""Metres."""
METRES_PER_COUNT = WHEEL_RADIUS * 0.0024369169
"""Wheel radius times radians per count."""
WHEELS = DifferentialDrive(left=METRES_PER_COUNT, right=METRES_PER_COUNT, track=0.230, bits=16, top_speed=0.7)


def packet_parser(counters: ParserCounters) -> FrameParser:
    """Return a parser for packets of either direction."""
    return FrameParser(HEADER, _size, lambda frame: reduce(xor, frame[2:]) == 0, counters)


def _size(buffer: bytearray) -> int:
    """Return the size of the packet at the beginning of a buffer, see `FrameParser`.

    The lengths of the parts must add up to the payload. This detects a wrong length before that many bytes have
    arrived, and lost bytes that the checksum misses.
    """
    if len(buffer) < 3:
        return 0
    part, end = 3, 3 + buffer[2]
    while part + 1 < min(end, len(buffer)):
        part += 2 + buffer[part + 1]
    invalid = part > end or part == end - 1 or not MIN_PAYLOAD <= buffer[2] <= MAX_PAYLOAD
    return -1 if invalid else end + 1


def encode_packet(*contents: tuple[int, bytes]) -> bytes:
    """Return a packet with parts (id, data)."""
    payload = b"".join(bytes([kind, len(data)]) + data for kind, data in contents)
    body = bytes([len(payload)]) + payload
    return HEADER + body + bytes([reduce(xor, body)])


def split_payload(frame: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the parts (id, data) of a packet."""
    payload = frame[3:-1]
    while payload:
        yield payload[0], payload[2 : 2 + payload[1]]
        payload = payload[2 + payload[1] :]


class Kobuki:
    """Host's side of the protocol, see `WheelBase`."""

    name: ClassVar[str] = "kobuki"
    baud: ClassVar[int] = 115200
    tick: ClassVar[float | None] = 0.001
    wraps_at: ClassVar[int | None] = 65536
    poll_period: ClassVar[float | None] = None

    def __init__(self, wheels: DifferentialDrive = WHEELS) -> None:
        self.wheels, self.counters = wheels, ParserCounters()
        self._frames = packet_parser(self.counters)

    def start(self) -> bytes:
        """Return nothing: the base sends without requests."""
        return b""

    def poll(self) -> bytes:
        """Return nothing: the base sends without requests."""
        return b""

    def enable_driving(self) -> bytes:
        """Return nothing: the base always obeys drive commands."""
        return b""

    def drive(self, velocity: Velocity) -> bytes:
        """Return the command with the outer wheel's speed and the radius of the arc."""
        left, right = (1000 * speed for speed in self.wheels.wheel_speeds(velocity.speed, velocity.turn_rate))
        half = 500 * self.wheels.track
        speed, radius = (left + right) / 2, 0
        if left != right:
            arc = half * (right + left) / (right - left)
            if abs(arc) <= MAX_RADIUS:
                radius = _radius(arc)
                outer = right if abs(right) >= abs(left) else left
                speed = outer if radius != 1 else (right - left) / 2
        return encode_packet((BASE_CONTROL, BASE_CONTROL_DATA.pack(round(speed), radius)))

    def end(self) -> bytes:
        """Return nothing: the readings cannot be ended."""
        return b""

    def feed(self, chunk: bytes) -> list[WheelReading]:
        """Return the readings that a chunk completes; packets without the core part contain none."""
        readings = []
        for frame in self._frames.feed(chunk):
            sizes = {CORE: CORE_DATA.size, INERTIA: INERTIA_DATA.size}
            found = {kind: data for kind, data in split_payload(frame) if len(data) == sizes.get(kind)}
            if CORE in found:
                self.counters.good += 1
                readings.append(_reading(found[CORE], found.get(INERTIA)))
        return readings


def _radius(arc: float) -> int:
    """Return the radius (mm) to command for an arc: 1 is reserved for turning on the spot, so arcs have 2 at least."""
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
    """Device's side of the protocol, see `WheelDevice`."""

    def __init__(self, wheels: DifferentialDrive = WHEELS) -> None:
        self.counters = ParserCounters()
        self._half = wheels.track / 2
        self._frames = packet_parser(self.counters)

    def encode(self, reading: WheelReading) -> bytes:
        """Return one packet, with a gyro part if the reading has a heading."""
        battery = round(10 * (reading.battery or 0.0))
        time = (reading.time or 0) % 65536
        core = (CORE, CORE_DATA.pack(time, reading.left % 65536, reading.right % 65536, 0, 0, battery))
        if reading.heading is None:
            return encode_packet(core)
        return encode_packet(core, (INERTIA, INERTIA_DATA.pack(round(100 * math.degrees(reading.heading)), 0)))

    def feed(self, chunk: bytes) -> list[Request]:
        """Return the requests that a chunk completes."""
        requests: list[Request] = []
        for frame in self._frames.feed(chunk):
            for kind, data in split_payload(frame):
                if kind == BASE_CONTROL and len(data) == BASE_CONTROL_DATA.size:
                    self.counters.good += 1
                    requests.append(self._velocity(*BASE_CONTROL_DATA.unpack(data)))
        return requests

    def _velocity(self, outer: int, radius: int) -> Velocity:
        """Return the velocity for the speed of the outer wheel (mm/s) on an arc of a radius (mm)."""
        speed, arc = outer / 1000, radius / 1000
        if radius == 0:
            return Velocity(speed, 0.0)
        if radius == 1:
            return Velocity(0.0, speed / self._half)
        turn_rate = speed / (arc + math.copysign(self._half, arc))
        return Velocity(arc * turn_rate, turn_rate)
