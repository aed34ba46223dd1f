"""A pseudo terminal under a name of the user's choice."""

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
"""Linux's request for a terminal's settings with its speeds as numbers, on most processors; pyserial sets speeds that
have no name of their own.
"""
TERMIOS2 = struct.Struct("IIII20xII")
MAX_READ_SIZE = 65536
"""Bytes read at once."""


class PtyPort:
    """One end of a pseudo terminal; programs open the other by a symbolic link that keeps its name.

    path  of the link

    A link that is there already is replaced, as one left behind by a program that was killed; anything else is not.
    Raises PortError where the link cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._device = ""
        self._controller: int | None = None
        self.plug()

    def plug(self) -> None:
        """Make the port appear."""
        if self._controller is not None:
            return
        if not self.path.is_symlink() and self.path.exists():
            raise PortError(str(self.path), "exists, and is no link that could be replaced; choose another name")
        self._controller, other = pty.openpty()
        tty.setraw(other)  # else what is written before a program opens the port comes back as an echo
        os.set_blocking(self._controller, False)
        self._device = os.ttyname(other)
        os.close(other)  # so that it shows whether a program has opened it
        work = self.path.with_name(f".{self.path.name}-{os.getpid()}")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            work.unlink(missing_ok=True)
            work.symlink_to(self._device)
            work.replace(self.path)
        except OSError as failure:
            os.close(self._controller)
            self._controller = None
            raise PortError(str(self.path), f"no port can be made there: {failure.strerror}") from failure

    def unplug(self) -> None:
        """Make it disappear: programs that have it open find the connection lost. Any number of times."""
        if self._controller is None:
            return
        with suppress(OSError):  # gone, or replaced by another program's
            if self.path.readlink() == Path(self._device):
                self.path.unlink()
        os.close(self._controller)
        self._controller = None

    @property
    def is_plugged(self) -> bool:
        """Whether it is there."""
        return self._controller is not None

    @property
    def is_open(self) -> bool:
        """Whether a program has it open."""
        if self._controller is None:
            return False
        poll = select.poll()
        poll.register(self._controller, select.POLLIN)
        return not any(events & select.POLLHUP for _, events in poll.poll(0))

    @property
    def baud(self) -> int | None:
        """The speed that a program has set, bits a second; None where the system does not tell."""
        if self._controller is None:
            return None
        try:
            return int(TERMIOS2.unpack(fcntl.ioctl(self._controller, TCGETS2, bytes(TERMIOS2.size)))[-1])
        except OSError:
            return None

    def read(self) -> bytes:
        """What a program has written; does not wait."""
        if self._controller is None:
            return b""
        try:
            return os.read(self._controller, MAX_READ_SIZE)
        except OSError:  # nothing there, or nobody
            return b""

    def write(self, data: bytes) -> int:
        """Pass bytes on as far as the system's buffer, of about 16 000 bytes, takes them; how many it took."""
        if self._controller is None:
            return 0
        try:
            return os.write(self._controller, data)
        except OSError:
            return 0
