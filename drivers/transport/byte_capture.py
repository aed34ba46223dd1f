"""Byte captures: the raw bytes of a connection with their times.

A byte capture is a text file with one line per chunk, `<seconds> <arrow> <hex>`. The arrow `<` marks bytes from the
device, `>` bytes sent to it:

    8137.204512345 > a525
    8137.310274001 < a55a140000000418

The format can be attached to a report, read by people and cut with any editor. Empty lines and lines beginning with #
are ignored. An incomplete last line, as after a crash, is ignored too.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path

from ..errors import EndOfCaptureError, PortError, RecordingError
from .transport import LINE_BUFFER, Received, Transport

LINE_PATTERN = re.compile(r"([0-9]+(?:\.[0-9]+)?) ([<>]) ((?:[0-9a-fA-F]{2})+)")
FROM_DEVICE = "<"


class CapturingTransport:
    """A `Transport` that writes the bytes of another transport to a byte capture, either a new file or appended.

    failure  reason why the capture ended early, such as a full disk; None while it is being written. The connection
             continues in any case

    Raises PortError if the capture cannot be written at all.
    """

    def __init__(self, transport: Transport, path: str | Path, append: bool = False) -> None:
        self.name = transport.name
        self.failure: str | None = None
        self._transport = transport
        try:
            self._file = Path(path).open("a" if append else "w", encoding="ascii", buffering=1)  # noqa: SIM115
        except OSError as failure:
            raise PortError(self.name, f"the byte capture {path} cannot be written: {failure.strerror}") from failure
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
        """Set the connection's modem line; it is not captured."""
        return self._transport.set_dtr(asserted)

    def pulse_rts(self, duration: float) -> bool:
        """Pulse the connection's modem line; it is not captured."""
        return self._transport.pulse_rts(duration)

    def cancel(self) -> None:
        """Cancel the connection's read."""
        self._transport.cancel()

    def close(self) -> None:
        """Close the connection and the capture."""
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
    """A `Transport` that plays the device's bytes of a byte capture, with the captured times.

    path   of the byte capture
    paced  if True, reads take as long as they did originally; otherwise time passes only within the capture, and a read
           that would have timed out returns at once

    Written bytes are discarded. Reading beyond the end raises EndOfCaptureError. Raises RecordingError if the capture
    cannot be read or contains an invalid line.
    """

    def __init__(self, path: str | Path, paced: bool = False) -> None:
        self.name = str(path)
        self._paced = paced
        self._chunks = iter(read_received(path))
        self._time: float | None = None  # captured time, seconds
        self._cancelled = self._closed = False
        self._next = next(self._chunks, None)

    def read(self, timeout: float) -> Received:
        """Return the next chunk, or no bytes if the capture has none within `timeout` seconds."""
        if self._closed:
            raise EndOfCaptureError(self.name, "closed")
        if self._next is None:
            raise EndOfCaptureError(self.name, "the byte capture ends here")
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
        """Discard the bytes."""

    def set_dtr(self, asserted: bool) -> bool:
        """Return False: a byte capture has no modem lines."""
        return False

    def pulse_rts(self, duration: float) -> bool:
        """Return False: a byte capture has no modem lines."""
        return False

    def cancel(self) -> None:
        """Make the next read return at once."""
        self._cancelled = True

    def close(self) -> None:
        """Stop playing."""
        self._closed = True

    def _wait_if_paced(self, duration: float) -> None:
        if self._paced:
            time.sleep(max(duration, 0.0))


def read_received(path: str | Path) -> Iterator[Received]:
    """Return the chunks that came from the device. Raises RecordingError if the capture cannot be read."""
    return (received for direction, received in read_capture(path) if direction == FROM_DEVICE)


def read_capture(path: str | Path) -> Iterator[tuple[str, Received]]:
    """Yield (arrow, chunk) for both directions. Raises RecordingError if the capture cannot be read."""
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
                    raise RecordingError(path, number, "not a line of a byte capture: <seconds> <arrow> <hex>")
                data = bytes.fromhex(match[3])
                yield match[2], Received(data, float(match[1]), len(data) < LINE_BUFFER)
    except (OSError, UnicodeDecodeError) as failure:
        raise RecordingError(path, None, f"cannot be read: {failure}") from failure
