"""Packets of one length, found in a stream of bytes that may have lost, gained or damaged some."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .records import Bytes, Counters, Flags, Integers

SLICE = 1 << 15
"""Bytes taken on at once; bounds the memory of a search however much is fed."""


@dataclass(frozen=True, slots=True)
class Layout:
    """How a packet is told from other bytes.

    size    of a packet, bytes
    marks   ((mask, value), ...) that the packet's first bytes show: byte & mask == value
    intact  (m, size) packets that show the marks -> (m,) whether their checksum is right
    """

    size: int
    marks: tuple[tuple[int, int], ...]
    intact: Callable[[Bytes], Flags]

    def marked(self, data: Bytes) -> Flags:
        """Whether packets, the last axis of `data`, show the marks; shorter prefixes of packets may be given."""
        shown = np.ones(data.shape[:-1], dtype=np.bool_)
        for i, (mask, value) in enumerate(self.marks):
            shown &= (data[..., i] & mask) == value
        return shown


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Undamaged packets: `data` (m, size), `ends` (m,) bytes fed up to the last of each, `continuous` (m,) where
    nothing lies between a packet and the one before.
    """

    data: Bytes
    ends: Integers
    continuous: Flags


class Framer:
    """Finds the packets: where one is due it is taken if its marks and checksum are right, else one byte is skipped.

    What is found does not depend on the chunks. At most a packet less one byte is held.
    """

    def __init__(self, layout: Layout, counters: Counters) -> None:
        self.layout, self.counters = layout, counters
        self._held = np.empty(0, dtype=np.uint8)
        self._position = 0  # bytes fed before the first that is held
        self._locked = False  # the last packet ended where the first held byte is

    def feed(self, data: bytes) -> Frames:
        """The packets that these bytes complete."""
        size = self.layout.size
        parts: list[Bytes] = []
        ends: list[Integers] = []
        continuous: list[Flags] = []
        for first in range(0, len(data), SLICE):
            fresh = np.frombuffer(data, np.uint8, min(SLICE, len(data) - first), first)
            held = np.concatenate([self._held, fresh])
            at = 0
            while len(held) - at >= size:
                frames = self._run(held[at:])
                if count := len(frames):
                    parts.append(frames)
                    ends.append(self._position + at + size * np.arange(1, count + 1))
                    flags = np.ones(count, dtype=np.bool_)
                    flags[0] = self._locked
                    continuous.append(flags)
                    self._locked = True
                    at += count * size
                else:
                    at += self._skip(held[at:])
            self._position += at
            self._held = held[at:].copy()
        self.counters.bytes += len(data)
        self.counters.packets += sum(map(len, parts))
        if not parts:
            return Frames(np.empty((0, size), np.uint8), np.empty(0, np.int64), np.empty(0, np.bool_))
        return Frames(np.concatenate(parts), np.concatenate(ends), np.concatenate(continuous))

    def _run(self, data: Bytes) -> Bytes:
        """The undamaged packets that follow each other from the first byte on."""
        size = self.layout.size
        frames = data[: len(data) // size * size].reshape(-1, size)
        good = self.layout.marked(frames)
        good[good] = self.layout.intact(frames[good])
        return frames if good.all() else frames[: int(np.argmin(good))]

    def _skip(self, data: Bytes) -> int:
        """How many bytes to pass, no packet being at the first, to where the next one is or may yet be."""
        size = self.layout.size
        windows = np.lib.stride_tricks.sliding_window_view(data, size)
        candidates = np.flatnonzero(self.layout.marked(windows))
        self.counters.checksum_failures += self._locked
        self._locked = False
        passed = len(windows)
        for candidate in candidates[candidates > 0]:
            if self.layout.intact(windows[candidate : candidate + 1])[0]:
                passed = int(candidate)
                break
        self.counters.bytes_skipped += passed
        return passed
