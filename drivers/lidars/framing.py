"""Packets of fixed length in a stream of bytes that may have lost, gained or damaged some."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ..immutable import immutable
from .measurements import Bytes, DecoderCounters, Flags, Integers

SLICE_SIZE = 1 << 15
"""Bytes processed at once; limits the memory of a search for any amount of input."""


def slices(data: bytes) -> Iterator[Bytes]:
    """Yield the bytes in arrays of at most SLICE_SIZE."""
    for first in range(0, len(data), SLICE_SIZE):
        yield np.frombuffer(data, np.uint8, min(SLICE_SIZE, len(data) - first), first)


@dataclass(frozen=True, slots=True)
class PacketLayout:
    """Marks and checksum that distinguish a packet from other bytes.

    size             bytes of a packet
    sync_marks       ((mask, value), ...) of the packet's first bytes: byte & mask == value
    checksums_match  function of packets (m, size) with the marks; returns (m,) whether their checksum is right
    """

    size: int
    sync_marks: tuple[tuple[int, int], ...]
    checksums_match: Callable[[Bytes], Flags]

    def has_sync_marks(self, data: Bytes) -> Flags:
        """Return whether packets, along the last axis of `data`, have the marks; prefixes of packets are allowed."""
        shown = np.ones(data.shape[:-1], dtype=np.bool_)
        for i, (mask, value) in enumerate(self.sync_marks):
            shown &= (data[..., i] & mask) == value
        return shown


@immutable
class PacketBatch:
    """Undamaged packets.

    data        (m, size)
    ends        (m,) bytes fed up to the last one of each packet
    continuous  (m,) True if the packet directly follows the previous one
    """

    data: Bytes
    ends: Integers
    continuous: Flags


class PacketFramer:
    """Search for the packets.

    If marks and checksum are right at the expected position, the packet is accepted; otherwise one byte is skipped. The
    result does not depend on the chunks. At most a packet less one byte is held.
    """

    def __init__(self, layout: PacketLayout, counters: DecoderCounters) -> None:
        self.layout, self.counters = layout, counters
        self._buffer = np.empty(0, dtype=np.uint8)
        self._position = 0  # bytes fed before the first that is held
        self._locked = False  # the last packet ended where the first held byte is

    def feed(self, data: bytes) -> PacketBatch:
        """Return the packets that these bytes complete."""
        size = self.layout.size
        parts: list[Bytes] = []
        ends: list[Integers] = []
        continuous: list[Flags] = []
        for new in slices(data):
            buffer = np.concatenate([self._buffer, new])
            start = 0
            while len(buffer) - start >= size:
                packets = self._leading_packets(buffer[start:])
                if count := len(packets):
                    parts.append(packets)
                    ends.append(self._position + start + size * np.arange(1, count + 1))
                    flags = np.ones(count, dtype=np.bool_)
                    flags[0] = self._locked
                    continuous.append(flags)
                    self._locked = True
                    start += count * size
                else:
                    start += self._skip(buffer[start:])
            self._position += start
            self._buffer = buffer[start:].copy()
        self.counters.bytes += len(data)
        self.counters.packets += sum(map(len, parts))
        if not parts:
            return PacketBatch(np.empty((0, size), np.uint8), np.empty(0, np.int64), np.empty(0, np.bool_))
        return PacketBatch(np.concatenate(parts), np.concatenate(ends), np.concatenate(continuous))

    def _leading_packets(self, data: Bytes) -> Bytes:
        """Return the undamaged packets that follow each other from the first byte on."""
        size = self.layout.size
        packets = data[: len(data) // size * size].reshape(-1, size)
        good = self.layout.has_sync_marks(packets)
        good[good] = self.layout.checksums_match(packets[good])
        return packets if good.all() else packets[: int(np.argmin(good))]

    def _skip(self, data: Bytes) -> int:
        """Return the number of bytes to skip, as no packet begins at the first one, up to where the next packet begins
        or may begin.
        """
        size = self.layout.size
        windows = np.lib.stride_tricks.sliding_window_view(data, size)
        candidates = np.flatnonzero(self.layout.has_sync_marks(windows))
        self.counters.checksum_failures += self._locked
        self._locked = False
        passed = len(windows)
        for candidate in candidates[candidates > 0]:
            if self.layout.checksums_match(windows[candidate : candidate + 1])[0]:
                passed = int(candidate)
                break
        self.counters.bytes_skipped += passed
        return passed
