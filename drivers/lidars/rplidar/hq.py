"""The high-quality format, response type 0x83: 96 nodes in 781 bytes, each with its own angle, with a 32-bit CRC."""

from __future__ import annotations

import zlib

import numpy as np

from ...messages import Floats
from ..framing import PacketFramer, PacketLayout
from ..measurements import (
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

NODES = 96
NODE = np.dtype([("angle", "<u2"), ("distance", "<u4"), ("quality", "u1"), ("flags", "u1")])
LAYOUT = np.dtype([("sync", "u1"), ("timestamp", "<u8"), ("nodes", NODE, NODES), ("crc", "<u4")])
SYNC = 0xA5
QUARTER = 1 << 14
"""Angle units in 90 degrees."""


def crc32_of(packet: bytes) -> int:
    """Return the CRC-32 of the bytes before the packet's CRC, padded with zeros to a multiple of four bytes."""
    body = packet[:-4]
    return zlib.crc32(body + bytes(-len(body) % 4))


def checksums_match(packets: Bytes) -> Flags:
    """Return whether the CRCs of packets (m, 781) are right."""
    stored = packets[:, -4:].copy().view("<u4")[:, 0]
    return np.asarray(stored == [crc32_of(packet.tobytes()) for packet in packets], dtype=np.bool_)


class HqDecoder:
    """`Decoder` of packets of 96 nodes.

    sample_period  seconds between samples
    baud           of the port, bits per second
    """

    def __init__(self, sample_period: float, baud: float) -> None:
        self.counters = DecoderCounters()
        self._framer = PacketFramer(PacketLayout(LAYOUT.itemsize, ((0xFF, SYNC),), checksums_match), self.counters)
        waiting = sample_period * (1.5 + np.arange(NODES - 1, -1, -1))
        self._offsets = -(LAYOUT.itemsize * 10.0 / baud + waiting)

    def feed(self, data: bytes) -> Measurements:
        """Return the measurements that these bytes complete."""
        batch = self._framer.feed(data)
        count = len(batch.data)
        if not count:
            return NO_MEASUREMENTS
        nodes = batch.data.view(LAYOUT)[:, 0]["nodes"].ravel()
        samples = np.empty(len(nodes), dtype=SAMPLE)
        samples["angle"] = to_counter_clockwise(nodes["angle"] * (np.pi / 2.0 / QUARTER))
        samples["range"] = np.where(nodes["distance"] > 0, nodes["distance"] / 4e3, np.nan)
        samples["quality"] = nodes["quality"]
        samples["start"] = nodes["flags"] & 1
        samples["offset"] = np.tile(self._offsets, count)
        samples["packet"] = np.repeat(np.arange(count), NODES)
        packets = np.empty(count, dtype=PACKET)
        packets["end"], packets["continuous"] = batch.ends, batch.continuous
        packets["device_time"] = np.nan  # the unit of the packet's timestamp is not documented
        self.counters.samples += len(samples)
        return Measurements(samples, packets)


def encode(angles: Floats, ranges: Floats, qualities: Integers, starts: Flags, timestamp: int = 0) -> bytes:
    """Encode packets (m,) of nodes, all with one device timestamp.

    angles     (m, 96) radians clockwise
    ranges     (m, 96) metres; NaN for no return
    qualities  (m, 96) 0 to 255
    starts     (m, 96) True where a revolution begins
    """
    packets = np.zeros(len(ranges), dtype=LAYOUT)
    packets["sync"], packets["timestamp"] = SYNC, timestamp
    nodes = packets["nodes"]
    nodes["angle"] = np.round(angles * (2.0 * QUARTER / np.pi)).astype(np.int64) % (4 * QUARTER)
    nodes["distance"] = np.round(np.nan_to_num(ranges) * 4e3)
    nodes["quality"], nodes["flags"] = qualities, starts
    for packet in packets:
        packet["crc"] = crc32_of(packet.tobytes())
    return packets.tobytes()
