"""A pseudo terminal with a name of the user's choice."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import struct
import tty
from contextlib import suppress
from pathlib import Path

from ..errors import PortError

TCGETS2 = 0x802C542A
"""Linux's ioctl request for a terminal's settings with numeric baud rates, on most processors; pyserial sets baud rates
without a termios constant.
"""
TERMIOS2 = struct.Struct("IIII20xII")
MAX_READ_SIZE = 65536
"""Bytes per read."""


class PtyPort:
    """One end of a pseudo terminal; programs open the other end by a symbolic link with a fixed name.

    path  of the link

    An existing link is replaced, such as one left by a killed program; any other file is kept. Raises PortError if the
    link cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._device = ""
        self._controller: int | None = None
        self.plug()

    def plug(self) -> None:
        """Create the port."""
        if self._controller is not None:
            return
        if not self.path.is_symlink() and self.path.exists():
            raise PortError(str(self.path), "exists and is no symbolic link; choose another name")
        self._controller, other = pty.openpty()
        tty.setraw(other)  # otherwise bytes written before a program opens the port are echoed
        os.set_blocking(self._controller, False)
        self._device = os.ttyname(other)
        os.close(other)  # so that `is_open` can detect a program
        work = self.path.with_name(f".{self.path.name}-{os.getpid()}")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            work.unlink(missing_ok=True)
            work.symlink_to(self._device)
            work.replace(self.path)
        except OSError as failure:
            os.close(self._controller)
            self._controller = None
            raise PortError(str(self.path), f"the port cannot be created: {failure.strerror}") from failure

    def unplug(self) -> None:
        """Remove the port; programs that have it open lose the connection. Further calls have no effect."""
        if self._controller is None:
            return
        with suppress(OSError):  # removed, or replaced by another program
            if self.path.readlink() == Path(self._device):
                self.path.unlink()
        os.close(self._controller)
        self._controller = None

    @property
    def is_plugged(self) -> bool:
        """True if the port exists."""
        return self._controller is not None

    @property
    def is_open(self) -> bool:
        """True if a program has it open."""
        if self._controller is None:
            return False
        poll = select.poll()
        poll.register(self._controller, select.POLLIN)
        return not any(events & select.POLLHUP for _, events in poll.poll(0))

    @property
    def baud(self) -> int | None:
        """Baud rate that a program has set, bits per second; None if unknown."""
        if self._controller is None:
            return None
        try:
            return int(TERMIOS2.unpack(fcntl.ioctl(self._controller, TCGETS2, bytes(TERMIOS2.size)))[-1])
        except OSError:
            return None

    def read(self) -> bytes:
        """Return the bytes written by a program, without waiting."""
        if self._controller is None:
            return b""
        try:
            return os.read(self._controller, MAX_READ_SIZE)
        except OSError:  # no bytes, or no program
            return b""

    def write(self, data: bytes) -> int:
        """Write bytes up to the free space of the system's buffer of about 16 000 bytes; return the number written."""
        if self._controller is None:
            return 0
        try:
            return os.write(self._controller, data)
        except OSError:
            return 0
