"""Wheel bases: their protocols, and the odometry that follows from their readings. Bytes in and out, no ports."""

from __future__ import annotations

from .arduino_bridge import ArduinoBridge, ArduinoBridgeDevice
from .create2 import Create2, Create2Device
from .interface import Poll, Request, Reset, Stream, Velocity, WheelBase, WheelDevice, WheelReading
from .kinematics import DifferentialDrive, Noise
from .kobuki import Kobuki, KobukiDevice
from .odometer import Odometer
from .wheel_line import WheelLine, WheelLineDevice

__all__ = [
    "ArduinoBridge",
    "ArduinoBridgeDevice",
    "Create2",
    "Create2Device",
    "DifferentialDrive",
    "Kobuki",
    "KobukiDevice",
    "Noise",
    "Odometer",
    "Poll",
    "Request",
    "Reset",
    "Stream",
    "Velocity",
    "WheelBase",
    "WheelDevice",
    "WheelLine",
    "WheelLineDevice",
    "WheelReading",
]
