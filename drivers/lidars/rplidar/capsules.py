"""Common part of the capsule formats: the head's angle at the beginning of a capsule, and samples spaced evenly up to
the beginning of the next one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...immutable import immutable
from ...messages import Floats
from ..framing import PacketFramer, PacketLayout
from ..measurements import (
    NO_MEASUREMENTS,
    NO_QUALITY,
    PACKET,
    SAMPLE,
    Bytes,
    DecoderCounters,
    Flags,
    Integers,
    Measurements,
    StructuredArray,
    to_counter_clockwise,
)
from .standard import TURN_Q6

SYNC_MARKS = ((0xF0, 0xA0), (0xF0, 0x50))
RESET_FLAG = 0x8000
"""Bit of the start angle: first capsule after the start, or reset of the angle. It does not mark a new revolution."""
MAX_ROTATION_RATE = 50.0
"""Revolutions per second that no RPLIDAR reaches (they turn 5 to 20 times): a larger step means that capsules in
between were lost, or that the head seemed to turn back.
"""


@immutable
class CapsuleReturns:
    """Content of m capsules of N samples.

    ranges      (m, N) metres, NaN if invalid
    quality     (m, N), or None if the format has none
    correction  (m, N) degrees to subtract from the head's angle, or None if there is no correction
    """

    ranges: Floats
    quality: Integers | None = None
    correction: Floats | None = None


@dataclass(frozen=True, slots=True)
class CapsuleFormat:
    """A capsule format.

    layout  packed bytes, with the start angle in the field `angle`
    decode  function of capsules (m,) and their successors (m,), both of `layout`, that returns CapsuleReturns
    """

    response_type: int
    layout: np.dtype[np.void]
    samples: int
    decode: Callable[[StructuredArray, StructuredArray], CapsuleReturns]

    @property
    def size(self) -> int:
        """Bytes of a capsule."""
        return self.layout.itemsize


def checksums_match(capsules: Bytes) -> Flags:
    """Return whether the low nibbles of the first two bytes are the XOR of all following bytes; capsules (m, size)."""
    stored = (capsules[:, 0] & 0x0F) | ((capsules[:, 1] & 0x0F) << 4)
    return np.asarray(stored == np.bitwise_xor.reduce(capsules[:, 2:], axis=1))


def add_checksums(capsules: StructuredArray) -> bytes:
    """Return the bytes of capsules (m,) with sync nibbles and checksum filled in."""
    raw = capsules.view(np.uint8).reshape(len(capsules), -1)
    checksum = np.bitwise_xor.reduce(raw[:, 2:], axis=1)
    raw[:, 0] = 0xA0 | (checksum & 0x0F)
    raw[:, 1] = 0x50 | (checksum >> 4)
    return raw.tobytes()


def new_capsules(format: CapsuleFormat, heads: Floats, reset: bool) -> StructuredArray:
    """Create capsules (m,) that begin with the head at `heads` (m,) radians clockwise; `reset` marks the first one as
    the first after a start.
    """
    capsules = np.zeros(len(heads), dtype=format.layout)
    capsules["angle"] = np.round(np.degrees(heads) * 64.0).astype(np.int64) % TURN_Q6
    if reset and len(heads):
        capsules["angle"][0] |= RESET_FLAG
    return capsules


class CapsuleDecoder:
    """`Decoder` of a stream of capsules.

    format         of the capsules
    sample_period  seconds between samples, as the device reports for the scan mode
    baud           of the port, bits per second

    A capsule's samples are known once the next one has arrived, undamaged and directly after it.
    """

    def __init__(self, format: CapsuleFormat, sample_period: float, baud: float) -> None:
        self.format, self.counters = format, DecoderCounters()
        self._framer = PacketFramer(PacketLayout(format.size, SYNC_MARKS, checksums_match), self.counters)
        count = format.samples
        # Delay of a sample: its period, half a period of filtering, the capsule's later samples, the transmission.
        self._offsets = -(format.size * 10.0 / baud + sample_period * (1.5 + np.arange(count - 1, -1, -1)))
        self._limit_q6 = min(TURN_Q6, int(TURN_Q6 * MAX_ROTATION_RATE * count * sample_period))
        self._last: Bytes | None = None  # the newest capsule, whose successor has not arrived yet
        self._last_end = 0
        self._head: int | None = None  # the head's angle at the last returned sample, in 1/64/count degrees
        self._emitted_end = -1  # end of the last capsule whose samples were returned

    def feed(self, data: bytes) -> Measurements:
        """Return the measurements that these bytes complete."""
        batch = self._framer.feed(data)
        if not len(batch.data):
            return NO_MEASUREMENTS
        raw, ends = batch.data, batch.ends
        follows = batch.continuous
        if self._last is not None:
            raw = np.concatenate([self._last[None], raw])
            ends = np.concatenate([[self._last_end], ends])
        else:
            follows = follows[1:]
        self._last, self._last_end = raw[-1].copy(), int(ends[-1])
        capsules = np.ascontiguousarray(raw).view(self.format.layout)[:, 0]
        words = capsules["angle"].astype(np.int64)
        heads = words & ~RESET_FLAG
        steps = np.mod(heads[1:] - heads[:-1], TURN_Q6)
        usable = follows & ((words[1:] & RESET_FLAG) == 0)
        plausible = (steps <= self._limit_q6) & (heads[:-1] < TURN_Q6) & (heads[1:] < TURN_Q6)
        self.counters.discarded += int(np.count_nonzero(~usable))
        self.counters.implausible += self.format.samples * int(np.count_nonzero(usable & ~plausible))
        pairs = np.flatnonzero(usable & plausible)
        if not len(pairs):
            return NO_MEASUREMENTS
        returns = self.format.decode(capsules[pairs], capsules[pairs + 1])
        return self._measurements(heads[pairs], steps[pairs], ends[pairs], returns)

    def _measurements(self, heads: Integers, steps: Integers, ends: Integers, returns: CapsuleReturns) -> Measurements:
        count, capsules = self.format.samples, len(heads)
        # In units of 1/64/count degrees all angles are integers, so rounding never makes the head seem to turn back.
        turn = TURN_Q6 * count
        angles = np.mod(heads[:, None] * count + steps[:, None] * np.arange(count), turn)
        swept = angles.ravel()
        before = np.concatenate([[swept[0] if self._head is None else self._head], swept[:-1]])
        self._head = int(swept[-1])
        degrees = angles / (64.0 * count)
        if returns.correction is not None:
            degrees = degrees - returns.correction
        samples = np.empty(capsules * count, dtype=SAMPLE)
        samples["angle"] = to_counter_clockwise(np.radians(degrees.ravel()))
        samples["range"] = returns.ranges.ravel()
        samples["quality"] = NO_QUALITY if returns.quality is None else returns.quality.ravel()
        samples["start"] = swept < before
        samples["offset"] = np.tile(self._offsets, capsules)
        samples["packet"] = np.repeat(np.arange(capsules), count)
        packets = np.empty(capsules, dtype=PACKET)
        packets["end"] = ends
        packets["device_time"] = np.nan
        packets["continuous"] = ends - self.format.size == np.concatenate([[self._emitted_end], ends[:-1]])
        self._emitted_end = int(ends[-1])
        self.counters.samples += len(samples)
        return Measurements(samples, packets)


def to_metres(distances: Integers) -> Floats:
    """Convert whole millimetres to metres; NaN for 0 and less, which mean no return."""
    return np.where(distances > 0, distances / 1e3, np.nan)


def to_millimetres(ranges: Floats, largest: int) -> Integers:
    """Convert metres to whole millimetres; 0 if there is no return or the range exceeds `largest`, the format's
    maximum.
    """
    stored = np.round(np.where(np.isfinite(ranges), ranges, 0.0) * 1e3)
    return np.where((stored > 0) & (stored <= largest), stored, 0).astype(np.int64)
