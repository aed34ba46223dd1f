"""Tapes: what passed through a connection, byte by byte, with times.

A tape is a text with a line for each chunk, `<seconds> <arrow> <hex>`, the arrow `<` for what came from the device and
`>` for what was sent to it:

    8137.204512345 > a525
    8137.310274001 < a55a140000000418

It is made to be attached to a report, read by people, and cut with any editor. Empty lines and lines that begin with #
say nothing. The last line is left out where it does not end, as after a crash.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path

from ..errors import EndOfCaptureError, PortError, RecordingError
from .transport import Received, Transport

LINE_PATTERN = re.compile(r"([0-9]+(?:\.[0-9]+)?) ([<>]) ((?:[0-9a-fA-F]{2})+)")
FROM_DEVICE = "<"


class CapturingTransport:
    """A `Transport` that writes what passes through another one to a tape, which is begun anew or gone on with.

    failure  why the tape ended early, as on a full disk; None while it goes on. The connection goes on anyhow

    Raises PortError where the tape cannot be written at all.
    """

    def __init__(self, transport: Transport, path: str | Path, append: bool = False) -> None:
        self.name = transport.name
        self.failure: str | None = None
        self._transport = transport
        try:
            self._file = Path(path).open("a" if append else "w", encoding="ascii", buffering=1)  # noqa: SIM115
        except OSError as failure:
            raise PortError(self.name, f"the tape {path} cannot be written: {failure.strerror}") from failure
        self._write_line(f"# {self.name}".encode("ascii", "backslashreplace").decode())

    def read(self, timeout: float) -> Received:
        """Read from the connection."""
        received = self._transport.read(timeout)
        if received.data:
            self._write_line(f"{received.time:.9f} < {received.data.hex()}")
        return received

    def write(self, data: bytes) -> None:
        """Write to the connection."""
        if data:
            self._write_line(f"{time.monotonic():.9f} > {data.hex()}")
        self._transport.write(data)

    def set_dtr(self, asserted: bool) -> bool:
        """Set the connection's line; the tape does not tell."""
        return self._transport.set_dtr(asserted)

    def cancel(self) -> None:
        """Cancel the connection's read."""
        self._transport.cancel()

    def close(self) -> None:
        """Close the connection and the tape."""
        self._transport.close()
        try:
            self._file.close()
        except OSError as failure:
            self.failure = self.failure or f"{failure.strerror}"

    def _write_line(self, line: str) -> None:
        if self.failure is None:
            try:
                self._file.write(line.replace("\n", " ") + "\n")
            except (OSError, ValueError) as failure:  # ValueError: closed
                self.failure = f"{failure}"


class ReplayTransport:
    """A `Transport` that plays what came from the device, with the times of the tape.

    path   of the tape
    paced  whether reads take as long as they took; without, time passes on the tape only, and a read that would have
           timed out returns at once

    What is written to it goes nowhere. Reading beyond the end raises EndOfTapeError. Raises RecordingError where the
    tape cannot be read, or has a line that is none.
    """

    def __init__(self, path: str | Path, paced: bool = False) -> None:
        self.name = str(path)
        self._paced = paced
        self._chunks = iter(read_received(path))
        self._time: float | None = None  # on the tape
        self._cancelled = self._closed = False
        self._next = next(self._chunks, None)

    def read(self, timeout: float) -> Received:
        """The next chunk, or nothing where the tape has none within the timeout (seconds)."""
        if self._closed:
            raise EndOfCaptureError(self.name, "closed")
        if self._next is None:
            raise EndOfCaptureError(self.name, "the tape ends here")
        now = self._next.time if self._time is None else self._time
        if self._cancelled:
            self._cancelled = False
            return Received(b"", now)
        if self._next.time > now + timeout:
            self._wait_if_paced(timeout)
            self._time = now + timeout
            return Received(b"", self._time)
        received, self._next = self._next, next(self._chunks, None)
        self._wait_if_paced(received.time - now)
        self._time = received.time
        return received

    def write(self, data: bytes) -> None:
        """Nothing: the device of a tape has said what it says."""

    def set_dtr(self, asserted: bool) -> bool:
        """There is no such line."""
        return False

    def cancel(self) -> None:
        """Make the next read return at once."""
        self._cancelled = True

    def close(self) -> None:
        """End playing."""
        self._closed = True

    def _wait_if_paced(self, duration: float) -> None:
        if self._paced:
            time.sleep(max(duration, 0.0))


def read_received(path: str | Path) -> Iterator[Received]:
    """The chunks that came from the device. Raises RecordingError where the tape cannot be read."""
    return (received for direction, received in read_capture(path) if direction == FROM_DEVICE)


def read_capture(path: str | Path) -> Iterator[tuple[str, Received]]:
    """The chunks in both directions, each with its arrow. Raises RecordingError where the tape cannot be read."""
    try:
        with Path(path).open(encoding="ascii", newline="\n") as file:
            for number, line in enumerate(file, start=1):
                if not line.endswith("\n"):
                    return
                text = line.strip()
                if not text or text.startswith("#"):
                    continue
                match = LINE_PATTERN.fullmatch(text)
                if match is None:
                    raise RecordingError(path, number, "not a line of a tape: <seconds> <arrow> <hex>")
                yield match[2], Received(bytes.fromhex(match[3]), float(match[1]))
    except (OSError, UnicodeDecodeError) as failure:
        raise RecordingError(path, None, f"cannot be read: {failure}") from failure
