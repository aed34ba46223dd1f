"""Serial ports, by pyserial."""

from __future__ import annotations

import errno
import termios
import time
from contextlib import suppress
from typing import Any

import serial

from ..errors import ConnectionLostError, PortError
from .transport import Received, read_promptly

WRITE_TIMEOUT = 1.0
"""Seconds; requests are a few bytes, and a port that takes none for so long is stuck."""
PORT_ERRORS = (OSError, termios.error)
"""What pyserial and the system raise when a port is gone; pyserial's own errors are OSErrors."""
LOW_LATENCY_ERRORS = (ValueError, NotImplementedError)
"""What pyserial raises for a port, and on a system, without such a mode."""
NO_MODEM_LINE_CODES = (errno.ENOTTY, errno.EINVAL)
"""What setting a modem line fails with on ports that have none."""
REASONS = {
    errno.ENOENT: "no such port; is the device plugged in?",
    errno.EACCES: "permission denied; on most systems the user must be in the group dialout",
    errno.EAGAIN: "in use by another program",
    errno.EBUSY: "in use by another program",
    errno.ENOTTY: "not a serial port",
}


class SerialPort:
    """A `Transport` over a serial port, 8 bits, no parity, 1 stop bit.

    port  the device's path
    baud  bits a second
    dtr   how the line "data terminal ready" is set from the beginning. Asserted, it stops the motor of an RPLIDAR A1;
          a change of it restarts many Arduinos; boards that are USB devices themselves send nothing without it. The
          system may pulse it while it opens a port

    Nobody else can open the port meanwhile. Raises PortError where it cannot be opened.
    """

    def __init__(self, port: str, baud: int, dtr: bool = False) -> None:
        self.name = port
        self._timeout: float | None = None
        self._closed = False
        try:
            self._serial: Any = serial.Serial(None, baud, exclusive=True, write_timeout=WRITE_TIMEOUT)
            self._serial.port = port
            self._serial.dtr = self._serial.rts = dtr  # an ESP32 is held in reset while the two differ
            self._serial.open()
            with suppress(*LOW_LATENCY_ERRORS):
                self._serial.set_low_latency_mode(True)  # adapters hold bytes back for 16 ms without it
        except PORT_ERRORS as error:
            raise PortError(port, _reason(error)) from error
        except (ValueError, OverflowError) as error:
            raise PortError(port, f"{error}") from error

    def read(self, timeout: float) -> Received:
        """All that has arrived; waits at most a timeout (seconds) for the first byte."""
        try:
            if timeout != self._timeout:  # setting it configures the port
                self._serial.timeout = self._timeout = timeout
            first = self._serial.read(1)
            if not first:
                return Received(b"", time.monotonic())
            rest, arrived = read_promptly(lambda: self._serial.read(self._serial.in_waiting))
        except PORT_ERRORS as error:
            raise self._connection_lost(error) from error
        return Received(first + rest, arrived)

    def write(self, data: bytes) -> None:
        """Send; raises ConnectionLostError, too, where the port takes no bytes for a second."""
        try:
            self._serial.write(data)
        except PORT_ERRORS as error:
            raise self._connection_lost(error) from error

    def set_dtr(self, asserted: bool) -> bool:
        """Set the line; False on ports that have none, as pseudo terminals. It stays so when the port is closed."""
        if self._closed:
            raise ConnectionLostError(self.name, "closed")
        try:
            self._serial.dtr = asserted
        except PORT_ERRORS as error:
            if error.args[0] in NO_MODEM_LINE_CODES:
                return False
            raise self._connection_lost(error) from error
        self._keep_modem_lines()
        return True

    def cancel(self) -> None:
        """Make a read that waits, or else the next one, return at once."""
        self._serial.cancel_read()

    def close(self) -> None:
        """Give the port back."""
        self._closed = True
        self._serial.close()

    def _keep_modem_lines(self) -> None:
        """Have the lines stay as they are when the port is closed; else the motor of an A1 turns again."""
        try:
            attributes = termios.tcgetattr(self._serial.fileno())
            attributes[2] &= ~termios.HUPCL
            termios.tcsetattr(self._serial.fileno(), termios.TCSANOW, attributes)
        except termios.error as error:
            if error.args[0] != errno.EINVAL:  # which may be the answer to a speed that has no name in termios
                raise self._connection_lost(error) from error

    def _connection_lost(self, error: Exception) -> ConnectionLostError:
        return ConnectionLostError(self.name, "closed" if self._closed else f"connection lost: {_reason(error)}")


def _reason(error: Exception) -> str:
    code = getattr(error, "errno", None) or (error.args[0] if error.args else None)
    return REASONS.get(code, str(error)) if isinstance(code, int) else str(error)
