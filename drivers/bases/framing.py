"""Cutting a stream of bytes into frames or lines, and finding the next ones after damage."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from .interface import Counters


class Frames:
    """Finds binary frames that begin with a header and say how long they are.

    header    the bytes that every frame begins with
    size      the length in bytes of the frame that a buffer begins with: 0 where more bytes are needed to tell,
              negative where none can begin so
    valid     whether a complete frame is undamaged
    counters  damaged frames and skipped bytes are added to it

    Behind a damaged frame the search goes on at its second byte: a frame may begin within what only looked like one.
    Keeps no more bytes than the longest `size`.
    """

    def __init__(
        self,
        header: bytes,
        size: Callable[[bytearray], int],
        valid: Callable[[bytes], bool],
        counters: Counters,
    ) -> None:
        self._header, self._size, self._valid, self._counters = header, size, valid, counters
        self._buffer = bytearray()

    def feed(self, chunk: bytes) -> Iterator[bytes]:
        """The undamaged frames that a chunk completes. The bytes before one are counted as skipped when it comes."""
        self._buffer += chunk
        while self._seek():
            size = self._size(self._buffer)
            if size == 0 or size > len(self._buffer):
                return
            frame = bytes(self._buffer[: max(size, 0)])
            if frame and self._valid(frame):
                del self._buffer[:size]
                yield frame
            else:
                self._counters.bad += 1
                self._skip(1)

    def _seek(self) -> bool:
        """Bring the next header to the buffer's start; without one keep what may be the beginning of one."""
        found = self._buffer.find(self._header)
        if found < 0:
            kept = next(n for n in range(len(self._header) - 1, -1, -1) if self._buffer.endswith(self._header[:n]))
            self._skip(len(self._buffer) - kept)
            return False
        self._skip(found)
        return True

    def _skip(self, count: int) -> None:
        self._counters.skipped += count
        del self._buffer[:count]


class Lines:
    """Finds lines of text.

    end       what ends a line
    limit     the most bytes in a line without its end; what is longer is skipped up to the next end and counted bad
    counters  overlong lines are added to it
    """

    def __init__(self, end: bytes, limit: int, counters: Counters) -> None:
        self._end, self._limit, self._counters = end, limit, counters
        self._buffer = bytearray()
        self._overlong = False

    def feed(self, chunk: bytes) -> Iterator[bytes]:
        """The lines that a chunk completes, without their ends."""
        self._buffer += chunk
        while (found := self._buffer.find(self._end)) >= 0:
            line = bytes(self._buffer[:found])
            del self._buffer[: found + len(self._end)]
            if self._overlong or found > self._limit:
                self._counters.bad += 1
                self._counters.skipped += found + len(self._end)
                self._overlong = False
            else:
                yield line
        surplus = len(self._buffer) - self._limit - (len(self._end) - 1)
        if surplus > 0:
            self._overlong = True
            self._counters.skipped += surplus
            del self._buffer[:surplus]
