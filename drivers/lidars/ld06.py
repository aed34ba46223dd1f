"""LDROBOT LD06, LD19 and STL-27L: a one-way stream of packets of 12 measurements, turning clockwise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..messages import Floats
from .framing import PacketFramer, PacketLayout
from .measurements import (
    NO_MEASUREMENTS,
    PACKET,
    SAMPLE,
    Bytes,
    DecoderCounters,
    Flags,
    Integers,
    Measurements,
    to_counter_clockwise,
)

POINTS = 12


@dataclass(frozen=True, slots=True)
class Model:
    """A lidar with this stream, from its data sheet.

    baud         bits per second
    sample_rate  measurements per second
    range_min, range_max  metres
    has_strays   True if stray points must be filtered by their intensity
    """

    name: str
    baud: int
    sample_rate: float
    range_min: float
    range_max: float
    has_strays: bool


LD06 = Model("LD06 or LD19", 230400, 4500.0, 0.02, 12.0, True)
STL_27L = Model("STL-27L", 921600, 21600.0, 0.03, 25.0, False)
MODELS = (LD06, STL_27L)


def model_at(baud: int) -> Model:
    """Return the model that sends at a baud rate; an LD06 if none of them usually does."""
    return next((model for model in MODELS if model.baud == baud), LD06)


POINT = np.dtype([("distance", "<u2"), ("intensity", "u1")])
LAYOUT = np.dtype(
    [
        ("header", "u1"),
        ("length", "u1"),
        ("speed", "<u2"),  # degrees a second
        ("first", "<u2"),  # 1/100 degree
        ("points", POINT, POINTS),
        ("last", "<u2"),  # 1/100 degree
        ("time", "<u2"),  # milliseconds
        ("crc", "u1"),
    ]
)
HEADER, LENGTH = 0x54, 0x2C
TURN_HUNDREDTHS = 36000
TIME_WRAP = 30000
"""Milliseconds after which the device's clock restarts at zero."""
MAX_SPAN_FACTOR = 3.0
"""A packet is wrong if it spans more than this multiple of the angle that its speed allows. The example in the manual
spans 1.8 times that angle.
"""
POLYNOMIAL = 0x4D


def _crc_tables() -> Bytes:
    """Return the contributions of each value of each byte but the last to a packet's CRC, (size - 1, 256)."""
    table = np.arange(256)
    for _ in range(8):
        table = np.where(table & 0x80, (table << 1) ^ POLYNOMIAL, table << 1) & 0xFF
    tables = [table]
    while len(tables) < LAYOUT.itemsize - 1:
        tables.append(table[tables[-1]])
    return np.array(tables[::-1], dtype=np.uint8)


CRC_TABLES = _crc_tables()


def crc8(packets: Bytes) -> Bytes:
    """Return the CRC-8 of packets (m, 47): polynomial 4D, initial value 0, over all bytes but the last.

    The CRC is linear, so it is the XOR of the contributions of the bytes.
    """
    size = len(CRC_TABLES)
    return np.asarray(np.bitwise_xor.reduce(CRC_TABLES[np.arange(size), packets[:, :size]], axis=1), dtype=np.uint8)


def checksums_match(packets: Bytes) -> Flags:
    """Return whether the CRCs of packets (m, 47) are right."""
    return np.asarray(crc8(packets) == packets[:, -1])


class Ld06Decoder:
    """`Decoder` of the stream. The device's clock, which wraps every 30 s, is unwrapped."""

    def __init__(self, model: Model = LD06, baud: float | None = None) -> None:
        """`baud` if it is not the model's own, as behind a converter."""
        self.counters = DecoderCounters()
        self.sample_rate = sample_rate = model.sample_rate
        layout = PacketLayout(LAYOUT.itemsize, ((0xFF, HEADER), (0xFF, LENGTH)), checksums_match)
        self._framer = PacketFramer(layout, self.counters)
        self._offsets = -(LAYOUT.itemsize * 10.0 / (baud or model.baud) + np.arange(POINTS - 1, -1, -1) / sample_rate)
        self._angle: int | None = None  # of the last sample, in 1/1100 degree
        self._time: int | None = None  # of the last packet, milliseconds, unwrapped

    def feed(self, data: bytes) -> Measurements:
        """Return the measurements that these bytes complete."""
        batch = self._framer.feed(data)
        packets = batch.data.view(LAYOUT)[:, 0]
        span = np.mod(packets["last"].astype(np.int64) - packets["first"], TURN_HUNDREDTHS)
        fits = span <= packets["speed"] * (100.0 * MAX_SPAN_FACTOR * POINTS / self.sample_rate)
        self.counters.implausible += POINTS * int(np.count_nonzero(~fits))
        packets, span = packets[fits], span[fits]
        count = len(packets)
        if not count:
            return NO_MEASUREMENTS
        # In units of 1/1100 degree all angles are integers.
        angles = packets["first"].astype(np.int64)[:, None] * (POINTS - 1) + span[:, None] * np.arange(POINTS)
        angles = np.mod(angles, TURN_HUNDREDTHS * (POINTS - 1)).ravel()
        before = np.concatenate([angles[:1] if self._angle is None else [self._angle], angles[:-1]])
        self._angle = int(angles[-1])
        samples = np.empty(count * POINTS, dtype=SAMPLE)
        samples["angle"] = to_counter_clockwise(np.radians(angles / (100.0 * (POINTS - 1))))
        distance = packets["points"]["distance"].ravel()
        samples["range"] = np.where(distance > 0, distance / 1e3, np.nan)
        samples["quality"] = packets["points"]["intensity"].ravel()
        samples["start"] = before - angles > TURN_HUNDREDTHS * (POINTS - 1) // 2  # packets may overlap slightly
        samples["offset"] = np.tile(self._offsets, count)
        samples["packet"] = np.repeat(np.arange(count), POINTS)
        carriers = np.empty(count, dtype=PACKET)
        carriers["end"], carriers["continuous"] = batch.ends[fits], batch.continuous[fits]
        carriers["device_time"] = self._unwrapped(packets["time"].astype(np.int64)) / 1e3
        self.counters.samples += len(samples)
        return Measurements(samples, carriers)

    def _unwrapped(self, times: Integers) -> Integers:
        """Return milliseconds that continue from the last packet's time."""
        last = int(times[0]) if self._time is None else self._time
        unwrapped = last + np.cumsum(np.mod(np.diff(times, prepend=last % TIME_WRAP), TIME_WRAP))
        self._time = int(unwrapped[-1])
        return unwrapped


def encode(angles: Floats, ranges: Floats, intensities: Integers, speed: float, time: float) -> bytes:
    """Encode packets (m,), all with one device time.

    angles       (m, 2) radians clockwise of the first and the last point
    ranges       (m, 12) metres, NaN for no return
    intensities  (m, 12) 0 to 255
    speed        radians per second
    time         seconds on the device's clock
    """
    packets = np.zeros(len(ranges), dtype=LAYOUT)
    packets["header"], packets["length"] = HEADER, LENGTH
    packets["speed"] = round(np.degrees(speed))
    hundredths = np.round(np.degrees(angles) * 100.0).astype(np.int64) % TURN_HUNDREDTHS
    packets["first"], packets["last"] = hundredths[:, 0], hundredths[:, 1]
    millimetres = np.round(np.nan_to_num(ranges, posinf=0.0) * 1e3)
    packets["points"]["distance"] = np.where(millimetres <= 0xFFFF, millimetres, 0)
    packets["points"]["intensity"] = intensities
    packets["time"] = round(time * 1e3) % TIME_WRAP
    packets["crc"] = crc8(packets.view(np.uint8).reshape(len(packets), -1))
    return packets.tobytes()
