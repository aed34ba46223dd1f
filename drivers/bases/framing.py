"""Parsers that split a byte stream into frames or lines and resynchronise after damage."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from .interface import ParserCounters


class FrameParser:
    """Parser for binary frames that begin with a header and have a known length.

    header    bytes at the beginning of every frame
    size      returns the length in bytes of the frame at the beginning of a buffer: 0 if more bytes are needed to
              determine it, negative if no frame can begin like this
    valid     returns true if a complete frame is undamaged
    counters  counters of damaged frames and skipped bytes

    After a damaged frame the search continues at its second byte, since a frame may begin within it. The buffer is not
    longer than the largest `size`.
    """

    def __init__(
        self,
        header: bytes,
        size: Callable[[bytearray], int],
        valid: Callable[[bytes], bool],
        counters: ParserCounters,
    ) -> None:
        self._header, self._size, self._valid, self._counters = header, size, valid, counters
        self._buffer = bytearray()

    def feed(self, chunk: bytes) -> Iterator[bytes]:
        """Yield the undamaged frames that a chunk completes."""
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
        """Discard bytes up to the next header; if there is none, up to a possible beginning of one. True if found."""
        found = self._buffer.find(self._header)
        if found < 0:
            keep = next(n for n in range(len(self._header) - 1, -1, -1) if self._buffer.endswith(self._header[:n]))
            self._skip(len(self._buffer) - keep)
            return False
        self._skip(found)
        return True

    def _skip(self, count: int) -> None:
        self._counters.skipped += count
        del self._buffer[:count]


class LineParser:
    """Parser for lines of text.

    end       line terminator
    limit     maximum length of a line in bytes, without its terminator; longer lines are skipped and counted as bad
    counters  counters of bad lines and skipped bytes
    """

    def __init__(self, end: bytes, limit: int, counters: ParserCounters) -> None:
        self._end, self._limit, self._counters = end, limit, counters
        self._buffer = bytearray()
        self._overlong = False

    def feed(self, chunk: bytes) -> Iterator[bytes]:
        """Yield the lines that a chunk completes, without their terminators."""
        self._buffer += chunk
        while (found := self._buffer.find(self._end)) >= 0:
            line = bytes(self._buffer[:found])
            del self._buffer[: found + len(self._end)]
            if self._overlong or found > self._limit:
                self.reject(line)
                self._overlong = False
            else:
                yield line
        surplus = len(self._buffer) - self._limit - (len(self._end) - 1)
        if surplus > 0:
            self._overlong = True
            self._counters.skipped += surplus
            del self._buffer[:surplus]

    def reject(self, line: bytes) -> None:
        """Count a line as bad, and its bytes as skipped."""
        self._counters.bad += 1
        self._counters.skipped += len(line) + len(self._end)
