"""Serial devices behind a network, as raw bytes over TCP: serial servers and lidars with Ethernet."""

from __future__ import annotations

import selectors
import socket

from ..errors import ConnectionLostError, PortError
from .transport import Received, read_promptly

CONNECT_TIMEOUT = 3.0
"""Seconds; devices are on the local network."""
WRITE_TIMEOUT = 1.0
"""Seconds, as for serial ports."""
MAX_READ_SIZE = 65536
"""Bytes per read."""


class TcpConnection:
    """A `Transport` to host:port. Raises PortError if the connection cannot be made."""

    def __init__(self, host: str, port: int) -> None:
        self.name = f"{host}:{port}"
        self._closed = False
        try:
            self._socket = socket.create_connection((host, port), CONNECT_TIMEOUT)
        except (OSError, OverflowError) as failure:
            raise PortError(self.name, f"no connection: {failure}") from failure
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(WRITE_TIMEOUT)
        self._wake_receiver, self._wake_sender = socket.socketpair()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._socket, selectors.EVENT_READ)
        self._selector.register(self._wake_receiver, selectors.EVENT_READ)

    def read(self, timeout: float) -> Received:
        """Return all bytes that have arrived; wait at most `timeout` seconds for the first one."""
        self._check_open()
        self._selector.select(timeout)
        return read_promptly(self._read_available)

    def write(self, data: bytes) -> None:
        """Send bytes; also raises ConnectionLostError if the other side accepts none for a second."""
        self._check_open()
        try:
            self._socket.sendall(data)
        except OSError as failure:
            raise ConnectionLostError(self.name, f"connection lost: {failure}") from failure

    def set_dtr(self, asserted: bool) -> bool:
        """Return False: TCP has no modem lines."""
        self._check_open()
        return False

    def pulse_rts(self, duration: float) -> bool:
        """Return False: TCP has no modem lines."""
        self._check_open()
        return False

    def cancel(self) -> None:
        """Make a waiting read, or else the next one, return at once."""
        if not self._closed:
            self._wake_sender.send(b"\0")

    def close(self) -> None:
        """Close the connection."""
        if not self._closed:
            self._closed = True
            self._selector.close()
            for end in (self._socket, self._wake_receiver, self._wake_sender):
                end.close()

    def _read_available(self) -> bytes:
        """Return the available bytes without waiting."""
        ready = [key.fileobj for key, _ in self._selector.select(0.0)]
        if self._wake_receiver in ready:
            self._wake_receiver.recv(MAX_READ_SIZE)
        if self._socket not in ready:
            return b""
        try:
            data = self._socket.recv(MAX_READ_SIZE)
        except OSError as failure:
            raise ConnectionLostError(self.name, f"connection lost: {failure}") from failure
        if not data:
            raise ConnectionLostError(self.name, "closed by the other side")
        return data

    def _check_open(self) -> None:
        if self._closed:
            raise ConnectionLostError(self.name, "closed")
