"""The standard format, answer 0x81: a node of 5 bytes for every sample, with three check bits and no checksum.

A byte lost or gained shifts all that follows, and shifted nodes often look right: a quarter of them pass their check
bits. So nodes are believed by what comes after them. Where a node is wrong, the decoder looks for the alignment in
which the next nodes are right and go on turning, then follows that alignment back to where it begins to be right;
bytes that both alignments claim are given to neither.
"""

from __future__ import annotations

import numpy as np

from ...messages import Floats
from ..records import (
    NOTHING,
    PACKET,
    SAMPLE,
    Bytes,
    Counters,
    Flags,
    Integers,
    Measurements,
    Records,
    counter_clockwise,
)

ANSWER = 0x81
NODE = np.dtype([("flags", "u1"), ("angle", "<u2"), ("distance", "<u2")])
SIZE = NODE.itemsize
TURN_Q6 = 360 * 64
LARGEST = 0xFFFF * 0.25e-3
"""Metres; what the format can tell."""

AHEAD = 8
"""Nodes that must be right after a node before it is believed. Misaligned nodes rarely are so often in a row: each is
with probability 0.25 by its check bits, and its angle would have to follow the last one's."""
LOCK = 16
"""Nodes in a row that begin a stream, where no angle before them helps."""
LOST = 32 * SIZE
"""Bytes after a fault beyond which the head's angle is no longer predicted."""
STEP_BACK, STEP_ON = 16 * 64, 24 * 64
"""Steps of angle between nodes that are plausible, 1/64 degree. Triangulating lidars correct each angle by -6 to 8
degrees with the distance."""
STEADY_BACK, STEADY_ON = 64, 3 * 64
"""The same where nothing corrects the angles: they may jitter, and 15 turns in 2 000 samples step by 2.7 degrees."""
SLICE = 1 << 15
"""Bytes taken on at once; bounds the memory of a search however much is fed."""


def checked(nodes: Records) -> Flags:
    """Whether nodes (n,) of NODE show their check bits: the start flag differs from its inverse beside it, the lowest
    bit of the angle is set, and the angle is one.
    """
    flags, angle = nodes["flags"], nodes["angle"]
    return np.asarray((((flags ^ (flags >> 1)) & 1) == 1) & ((angle & 1) == 1) & ((angle >> 1) < TURN_Q6 + 64))


def read(nodes: Records) -> Records:
    """Nodes (n,) of NODE as samples (n,) of SAMPLE, each in a packet of its own; without offsets."""
    samples = np.zeros(len(nodes), dtype=SAMPLE)
    samples["angle"] = counter_clockwise(np.radians((nodes["angle"] >> 1) / 64.0))
    samples["range"] = np.where(nodes["distance"] > 0, nodes["distance"] / 4e3, np.nan)
    samples["quality"] = nodes["flags"] >> 2
    samples["start"] = nodes["flags"] & 1
    samples["packet"] = np.arange(len(nodes))
    return samples


class StandardDecoder:
    """Decodes a stream of nodes, as a `Decoder`.

    sample_period  seconds between samples
    baud           of the port, bits a second
    corrected      whether the lidar triangulates, so that its angles are corrected by the distance and may step back;
                   the others' turn steadily, and damaged angles show

    A node is given out when AHEAD more have come.
    """

    def __init__(self, sample_period: float, baud: float, corrected: bool = True) -> None:
        self.counters = Counters()
        self._offset = -(SIZE * 10.0 / baud + 1.5 * sample_period)
        self._back, self._on = (STEP_BACK, STEP_ON) if corrected else (STEADY_BACK, STEADY_ON)
        self._held = np.empty(0, dtype=np.uint8)
        self._position = 0  # bytes fed before the first that is held
        self._aligned = False  # a node that may be believed begins with the first held byte
        self._given_end = -1  # end of the last node that was given out

    def feed(self, data: bytes) -> Measurements:
        """The measurements that these bytes complete."""
        nodes: list[Bytes] = []
        ends: list[Integers] = []
        for first in range(0, len(data), SLICE):
            fresh = np.frombuffer(data, np.uint8, min(SLICE, len(data) - first), first)
            self._held = np.concatenate([self._held, fresh])
            while (passed := self._advance(nodes, ends)) is not None:
                self._position += passed
                self._held = self._held[passed:]
            self._held = self._held.copy()  # lets the rest of the slice go
        self.counters.bytes += len(data)
        return self._measurements(np.concatenate(nodes), np.concatenate(ends)) if nodes else NOTHING

    def _advance(self, nodes: list[Bytes], ends: list[Integers]) -> int | None:
        """Give out the nodes that can be believed, or find where nodes begin; the bytes done with, None to wait."""
        if not self._aligned:
            return self._lock()
        due = self._held[: len(self._held) // SIZE * SIZE].view(NODE)
        good = np.logical_and(*self._judge(due, 1))
        right = len(due) if good.all() else int(np.argmin(good))
        believed = max(0, right - AHEAD)
        if believed:
            self._give(self._held, believed, nodes, ends)
            return believed * SIZE
        return None if right == len(due) else self._realign(right * SIZE, nodes, ends)

    def _judge(self, nodes: Records, apart: int) -> tuple[Flags, Flags]:
        """Whether nodes (n,) show their check bits, and whether each plausibly follows the one `apart` rows before."""
        angles = (nodes["angle"] >> 1).astype(np.int64)
        starts = nodes["flags"] & 1
        follows = np.ones(len(nodes), dtype=np.bool_)
        twice = (starts[apart:] & starts[:-apart]) == 1  # two starts are not next to each other
        follows[apart:] = ~twice & self._turns(angles[apart:] - angles[:-apart], self._on)
        return checked(nodes), follows

    def _turns(self, steps: Integers, most: int | Integers) -> Flags:
        """Whether steps of angle, in 1/64 degree, are between a little back and `most` on."""
        return np.asarray(np.mod(steps + self._back, TURN_Q6) <= self._back + most)

    def _runs(self, data: Bytes, length: int) -> tuple[Records, Flags, Flags, Flags]:
        """The nodes that would begin at each byte, whether they show their check bits, whether each plausibly follows
        the node SIZE bytes before, and whether as many as `length` in a row do both.
        """
        windows = np.lib.stride_tricks.sliding_window_view(data, SIZE)
        nodes = np.ascontiguousarray(windows).view(NODE)[:, 0]
        bits, follows = self._judge(nodes, SIZE)
        starts = max(0, len(nodes) - (length - 1) * SIZE)
        runs = bits[:starts].copy()
        for i in range(1, length):
            runs &= (bits & follows)[i * SIZE : i * SIZE + starts]
        return nodes, bits, follows, runs

    def _lock(self) -> int | None:
        """Pass what comes before the first run of LOCK nodes."""
        if len(self._held) < LOCK * SIZE:
            return None
        runs = self._runs(self._held, LOCK)[-1]
        self._aligned = bool(runs.any())
        passed = int(np.argmax(runs)) if self._aligned else len(runs)
        self.counters.bytes_skipped += passed
        return passed

    def _realign(self, fault: int, nodes: list[Bytes], ends: list[Integers]) -> int | None:
        """Find where nodes go on after the held ones up to byte `fault`, at which there is none that could follow."""
        window = self._held[: fault + LOST + AHEAD * SIZE]
        candidates, bits, follows, runs = self._runs(window, AHEAD)
        angles = (candidates["angle"] >> 1).astype(np.int64)
        reach = np.arange(len(runs) - fault)
        turned = self._turns(angles[fault : len(runs)] - angles[fault - SIZE], self._on + reach * STEADY_ON // SIZE)
        found = np.flatnonzero(runs[fault:] & turned)
        if not len(found):
            if len(window) < fault + LOST + AHEAD * SIZE:
                return None
            self._aligned = False
            return self._resume(fault // SIZE - 1, fault, nodes, ends)
        begin = fault + int(found[0])
        while begin >= SIZE and bits[begin - SIZE] and follows[begin]:
            begin -= SIZE
        kept, lead = fault // SIZE, begin - fault
        if lead % SIZE == 0:
            # Nothing is shifted. If the node at the fault fits what follows but not what precedes, either may be wrong.
            kept, begin = (kept - 1, fault + SIZE) if lead <= 0 else (kept, begin)
        elif lead < 0:
            kept, begin = begin // SIZE, fault + lead % SIZE  # both alignments claim the bytes between
        elif lead <= 2:
            kept -= 1  # bytes were inserted, and likely into the last node
        return self._resume(kept, begin, nodes, ends)

    def _resume(self, kept: int, begin: int, nodes: list[Bytes], ends: list[Integers]) -> int:
        """Give out the first `kept` nodes held, and go on with byte `begin`."""
        self._give(self._held, kept, nodes, ends)
        self.counters.checksum_failures += 1
        self.counters.bytes_skipped += begin - kept * SIZE
        return begin

    def _give(self, data: Bytes, count: int, nodes: list[Bytes], ends: list[Integers]) -> None:
        nodes.append(data[: count * SIZE])
        ends.append(self._position + SIZE * np.arange(1, count + 1))

    def _measurements(self, raw: Bytes, ends: Integers) -> Measurements:
        samples = read(raw.view(NODE))
        samples["offset"] = self._offset
        packets = np.empty(len(samples), dtype=PACKET)
        packets["end"] = ends
        packets["device_time"] = np.nan
        packets["continuous"] = ends - SIZE == np.concatenate([[self._given_end], ends[:-1]])
        if len(ends):
            self._given_end = int(ends[-1])
        self.counters.packets += len(samples)
        self.counters.samples += len(samples)
        return Measurements(samples, packets)


def encode(angles: Floats, ranges: Floats, qualities: Integers, starts: Flags) -> bytes:
    """Nodes (n,): `angles` radians clockwise, `ranges` metres (NaN where nothing came back, or beyond LARGEST),
    `qualities` 0 to 63, `starts` whether a revolution begins.
    """
    nodes = np.zeros(len(ranges), dtype=NODE)
    nodes["flags"] = np.where(starts, 1, 2) | (qualities << 2)
    nodes["angle"] = ((np.round(np.degrees(angles) * 64.0).astype(np.int64) % TURN_Q6) << 1) | 1
    told = np.nan_to_num(np.where(ranges <= LARGEST, ranges, 0.0))
    nodes["distance"] = np.round(told * 4e3)
    return nodes.tobytes()
