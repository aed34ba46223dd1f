"""Connections to devices: serial ports, TCP and byte captures. They carry bytes and contain no protocol."""

from __future__ import annotations

from .byte_capture import CapturingTransport, ReplayTransport
from .serial_port import SerialPort
from .tcp import TcpConnection
from .transport import Received, Transport

__all__ = ["CapturingTransport", "Received", "ReplayTransport", "SerialPort", "TcpConnection", "Transport"]
