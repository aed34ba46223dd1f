"""Serial ports, using pyserial."""

from __future__ import annotations

import errno
import termios
import time
from contextlib import suppress
from typing import Any

import serial

from ..errors import ConnectionLostError, PortError
from .transport import LINE_BUFFER, Received, read_promptly

WRITE_TIMEOUT = 1.0
"""Seconds; requests are a few bytes long, so a port that accepts none for this long is stuck."""
PORT_ERRORS = (OSError, termios.error)
"""Exceptions of pyserial and the system when a port is gone; pyserial's own exceptions are OSErrors."""
NO_MODEM_LINE_CODES = (errno.ENOTTY, errno.EINVAL)
"""Error codes of setting a modem line on a port that has none."""
REASONS = {
    errno.ENOENT: "no such port; is the device plugged in?",
    errno.EACCES: "permission denied; on most systems the user must be in the group dialout",
    errno.EAGAIN: "in use by another program",
    errno.EBUSY: "in use by another program",
    errno.ENOTTY: "not a serial port",
}


class SerialPort:
    """A `Transport` over a serial port with 8 data bits, no parity and 1 stop bit.

    port  path of the device
    baud  bits per second
    dtr   state of the modem line "data terminal ready" from the beginning. If asserted, it stops the motor of an
          RPLIDAR A1; a change restarts many Arduinos; boards with native USB send nothing without it. The system may
          pulse it while opening a port

    The port is opened exclusively. Raises PortError if it cannot be opened.
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
            with suppress(ValueError, NotImplementedError):  # not every port and system has this mode
                self._serial.set_low_latency_mode(True)  # otherwise adapters delay bytes by 16 ms
        except PORT_ERRORS as error:
            raise PortError(port, _reason(error)) from error
        except (ValueError, OverflowError) as error:
            raise PortError(port, f"{error}") from error

    def read(self, timeout: float) -> Received:
        """Return the bytes that are available; wait at most `timeout` seconds for the first one."""
        try:
            if timeout != self._timeout:  # setting the timeout reconfigures the port
                self._serial.timeout = self._timeout = timeout
            first = self._serial.read(1)
            if not first:
                return Received(b"", time.monotonic())
            rest, arrived, complete = read_promptly(
                lambda: self._serial.read(self._serial.in_waiting), LINE_BUFFER - len(first)
            )
        except PORT_ERRORS as error:
            raise self._connection_lost(error) from error
        return Received(first + rest, arrived, complete)

    def write(self, data: bytes) -> None:
        """Send bytes; also raises ConnectionLostError if the port accepts none for a second."""
        try:
            self._serial.write(data)
        except PORT_ERRORS as error:
            raise self._connection_lost(error) from error

    def set_dtr(self, asserted: bool) -> bool:
        """Set the modem line; return False for ports without one, such as pseudo terminals. It keeps its state when the
        port is closed.
        """
        if not self._set_line("dtr", asserted):
            return False
        self._keep_modem_lines()
        return True

    def pulse_rts(self, duration: float) -> bool:
        """Assert the modem line "request to send" for some seconds; return False for ports without one."""
        if not self._set_line("rts", True):
            return False
        time.sleep(duration)
        return self._set_line("rts", False)

    def cancel(self) -> None:
        """Make a waiting read, or else the next one, return at once."""
        self._serial.cancel_read()

    def close(self) -> None:
        """Close the port."""
        self._closed = True
        self._serial.close()

    def _set_line(self, name: str, asserted: bool) -> bool:
        """Set a modem line, dtr or rts; return False for ports without one."""
        if self._closed:
            raise ConnectionLostError(self.name, "closed")
        try:
            setattr(self._serial, name, asserted)
        except PORT_ERRORS as error:
            if error.args[0] in NO_MODEM_LINE_CODES:
                return False
            raise self._connection_lost(error) from error
        return True

    def _keep_modem_lines(self) -> None:
        """Keep the modem lines unchanged when the port is closed; otherwise the motor of an A1 starts again."""
        try:
            attributes = termios.tcgetattr(self._serial.fileno())
            attributes[2] &= ~termios.HUPCL
            termios.tcsetattr(self._serial.fileno(), termios.TCSANOW, attributes)
        except termios.error as error:
            if error.args[0] != errno.EINVAL:  # returned for baud rates without a termios constant
                raise self._connection_lost(error) from error

    def _connection_lost(self, error: Exception) -> ConnectionLostError:
        return ConnectionLostError(self.name, "closed" if self._closed else f"connection lost: {_reason(error)}")


def _reason(error: Exception) -> str:
    code = getattr(error, "errno", None) or (error.args[0] if error.args else None)
    return REASONS.get(code, str(error)) if isinstance(code, int) else str(error)
