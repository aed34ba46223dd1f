"""The standard format, response type 0x81: a node of 5 bytes per sample, with three check bits and no checksum.

A lost or gained byte shifts all following ones, and shifted nodes often look right: a quarter of them pass their check
bits. A node is therefore accepted only after the following nodes have confirmed it. After a wrong node, the decoder
searches the alignment in which the next nodes are right and continue to turn, then follows that alignment back to its
first right node; bytes that both alignments claim are discarded.
"""

from __future__ import annotations

import numpy as np

from ...messages import Floats
from ..framing import slices
from ..measurements import (
    NO_MEASUREMENTS,
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

NODE = np.dtype([("flags", "u1"), ("angle", "<u2"), ("distance", "<u2")])
SIZE = NODE.itemsize
TURN_Q6 = 360 * 64
MAX_RANGE = 0xFFFF * 0.25e-3
"""Metres; the maximum of the format."""

CONFIRMING_NODES = 8
"""Right nodes that must follow a node before it is accepted. Misaligned nodes are rarely right so often in a row: each
one passes its check bits with probability 0.25, and its angle would have to follow the previous one.
"""
LOCK_NODES = 16
"""Nodes in a row that begin a stream, without a previous angle to compare with."""
MAX_PREDICTED_BYTES = 32 * SIZE
"""Bytes after a fault beyond which the head's angle is no longer predicted."""
CORRECTED_STEP_BACK, CORRECTED_STEP_FORWARD = 16 * 64, 24 * 64
"""Plausible steps of angle between nodes, 1/64 degree. Triangulating lidars correct each angle by -6 to 8 degrees
depending on the distance.
"""
STEADY_STEP_BACK, STEADY_STEP_FORWARD = 64, 3 * 64
"""The same for lidars that do not correct angles: they may jitter, and 15 turns in 2 000 samples step by 2.7 degrees.
"""


def check_bits_match(nodes: StructuredArray) -> Flags:
    """Return whether nodes (n,) of NODE have the right check bits: the start flag differs from its inverse, the lowest
    bit of the angle is set, and the angle is valid.
    """
    flags, angle = nodes["flags"], nodes["angle"]
    return np.asarray((((flags ^ (flags >> 1)) & 1) == 1) & ((angle & 1) == 1) & ((angle >> 1) < TURN_Q6 + 64))


def decode_nodes(nodes: StructuredArray) -> StructuredArray:
    """Convert nodes (n,) of NODE to samples (n,) of SAMPLE, each in a packet of its own; without offsets."""
    samples = np.zeros(len(nodes), dtype=SAMPLE)
    samples["angle"] = to_counter_clockwise(np.radians((nodes["angle"] >> 1) / 64.0))
    samples["range"] = np.where(nodes["distance"] > 0, nodes["distance"] / 4e3, np.nan)
    samples["quality"] = nodes["flags"] >> 2
    samples["start"] = nodes["flags"] & 1
    samples["packet"] = np.arange(len(nodes))
    return samples


class StandardDecoder:
    """`Decoder` of a stream of nodes.

    sample_period  seconds between samples
    baud           of the port, bits per second
    triangulates   True if angles are corrected by the distance and may step back; otherwise they increase steadily,
                   which reveals damaged angles

    A node is returned when CONFIRMING_NODES more have arrived.
    """

    def __init__(self, sample_period: float, baud: float, triangulates: bool = True) -> None:
        self.counters = DecoderCounters()
        self._offset = -(SIZE * 10.0 / baud + 1.5 * sample_period)
        self._max_back, self._max_forward = (
            (CORRECTED_STEP_BACK, CORRECTED_STEP_FORWARD) if triangulates else (STEADY_STEP_BACK, STEADY_STEP_FORWARD)
        )
        self._buffer = np.empty(0, dtype=np.uint8)
        self._position = 0  # bytes fed before the first that is held
        self._aligned = False  # a valid node begins with the first held byte
        self._emitted_end = -1  # end of the last returned node

    def feed(self, data: bytes) -> Measurements:
        """Return the measurements that these bytes complete."""
        nodes: list[Bytes] = []
        ends: list[Integers] = []
        for new in slices(data):
            self._buffer = np.concatenate([self._buffer, new])
            while (passed := self._advance(nodes, ends)) is not None:
                self._position += passed
                self._buffer = self._buffer[passed:]
            self._buffer = self._buffer.copy()  # releases the rest of the slice
        self.counters.bytes += len(data)
        return self._measurements(np.concatenate(nodes), np.concatenate(ends)) if nodes else NO_MEASUREMENTS

    def _advance(self, nodes: list[Bytes], ends: list[Integers]) -> int | None:
        """Emit the confirmed nodes, or find where nodes begin; return the number of processed bytes, None to wait for
        more.
        """
        if not self._aligned:
            return self._align()
        due = self._buffer[: len(self._buffer) // SIZE * SIZE].view(NODE)
        valid = np.logical_and(*self._check_nodes(due, 1))
        right = len(due) if valid.all() else int(np.argmin(valid))
        confirmed = max(0, right - CONFIRMING_NODES)
        if confirmed:
            self._emit(self._buffer, confirmed, nodes, ends)
            return confirmed * SIZE
        return None if right == len(due) else self._realign(right * SIZE, nodes, ends)

    def _check_nodes(self, nodes: StructuredArray, apart: int) -> tuple[Flags, Flags]:
        """Return whether nodes (n,) have the right check bits, and whether each plausibly follows the one `apart` rows
        before.
        """
        angles = (nodes["angle"] >> 1).astype(np.int64)
        starts = nodes["flags"] & 1
        follows = np.ones(len(nodes), dtype=np.bool_)
        twice = (starts[apart:] & starts[:-apart]) == 1  # two starts are not next to each other
        follows[apart:] = ~twice & self._is_plausible_step(angles[apart:] - angles[:-apart], self._max_forward)
        return check_bits_match(nodes), follows

    def _is_plausible_step(self, steps: Integers, max_forward: int | Integers) -> Flags:
        """Return whether steps of angle, in 1/64 degree, are between a little back and `max_forward` forward."""
        return np.asarray(np.mod(steps + self._max_back, TURN_Q6) <= self._max_back + max_forward)

    def _find_runs(self, data: Bytes, length: int) -> tuple[StructuredArray, Flags, Flags, Flags]:
        """Check the nodes that would begin at each byte.

        Return the nodes, whether their check bits are right, whether each plausibly follows the node SIZE bytes before,
        and whether both hold for `length` nodes in a row.
        """
        windows = np.lib.stride_tricks.sliding_window_view(data, SIZE)
        nodes = np.ascontiguousarray(windows).view(NODE)[:, 0]
        bits, follows = self._check_nodes(nodes, SIZE)
        starts = max(0, len(nodes) - (length - 1) * SIZE)
        runs = bits[:starts].copy()
        for i in range(1, length):
            runs &= (bits & follows)[i * SIZE : i * SIZE + starts]
        return nodes, bits, follows, runs

    def _align(self) -> int | None:
        """Skip the bytes before the first run of LOCK_NODES nodes."""
        if len(self._buffer) < LOCK_NODES * SIZE:
            return None
        runs = self._find_runs(self._buffer, LOCK_NODES)[-1]
        self._aligned = bool(runs.any())
        passed = int(np.argmax(runs)) if self._aligned else len(runs)
        self.counters.bytes_skipped += passed
        return passed

    def _realign(self, fault: int, nodes: list[Bytes], ends: list[Integers]) -> int | None:
        """Find where nodes continue after byte `fault`, at which no plausible node begins."""
        window = self._buffer[: fault + MAX_PREDICTED_BYTES + CONFIRMING_NODES * SIZE]
        candidates, bits, follows, runs = self._find_runs(window, CONFIRMING_NODES)
        angles = (candidates["angle"] >> 1).astype(np.int64)
        reach = np.arange(len(runs) - fault)
        turned = self._is_plausible_step(
            angles[fault : len(runs)] - angles[fault - SIZE], self._max_forward + reach * STEADY_STEP_FORWARD // SIZE
        )
        found = np.flatnonzero(runs[fault:] & turned)
        if not len(found):
            if len(window) < fault + MAX_PREDICTED_BYTES + CONFIRMING_NODES * SIZE:
                return None
            self._aligned = False
            return self._resume(fault // SIZE - 1, fault, nodes, ends)
        begin = fault + int(found[0])
        while begin >= SIZE and bits[begin - SIZE] and follows[begin]:
            begin -= SIZE
        kept, lead = fault // SIZE, begin - fault
        if lead % SIZE == 0:
            # No shift. If the node at the fault fits its successors but not its predecessor, either may be wrong.
            kept, begin = (kept - 1, fault + SIZE) if lead <= 0 else (kept, begin)
        elif lead < 0:
            kept, begin = begin // SIZE, fault + lead % SIZE  # both alignments claim the bytes between
        elif lead <= 2:
            kept -= 1  # bytes were inserted, and likely into the last node
        return self._resume(kept, begin, nodes, ends)

    def _resume(self, kept: int, begin: int, nodes: list[Bytes], ends: list[Integers]) -> int:
        """Emit the first `kept` nodes, and continue with byte `begin`."""
        self._emit(self._buffer, kept, nodes, ends)
        self.counters.checksum_failures += 1
        self.counters.bytes_skipped += begin - kept * SIZE
        return begin

    def _emit(self, data: Bytes, count: int, nodes: list[Bytes], ends: list[Integers]) -> None:
        nodes.append(data[: count * SIZE])
        ends.append(self._position + SIZE * np.arange(1, count + 1))

    def _measurements(self, raw: Bytes, ends: Integers) -> Measurements:
        samples = decode_nodes(raw.view(NODE))
        samples["offset"] = self._offset
        packets = np.empty(len(samples), dtype=PACKET)
        packets["end"] = ends
        packets["device_time"] = np.nan
        packets["continuous"] = ends - SIZE == np.concatenate([[self._emitted_end], ends[:-1]])
        if len(ends):
            self._emitted_end = int(ends[-1])
        self.counters.packets += len(samples)
        self.counters.samples += len(samples)
        return Measurements(samples, packets)


def encode(angles: Floats, ranges: Floats, qualities: Integers, starts: Flags) -> bytes:
    """Encode nodes (n,).

    angles     (n,) radians clockwise
    ranges     (n,) metres; NaN for no return, also encoded for ranges beyond MAX_RANGE
    qualities  (n,) 0 to 63
    starts     (n,) True where a revolution begins
    """
    nodes = np.zeros(len(ranges), dtype=NODE)
    nodes["flags"] = np.where(starts, 1, 2) | (qualities << 2)
    nodes["angle"] = ((np.round(np.degrees(angles) * 64.0).astype(np.int64) % TURN_Q6) << 1) | 1
    stored = np.nan_to_num(np.where(ranges <= MAX_RANGE, ranges, 0.0))
    nodes["distance"] = np.round(stored * 4e3)
    return nodes.tobytes()
