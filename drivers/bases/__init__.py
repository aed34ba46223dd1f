"""Wheel bases: their serial protocols, and odometry from their encoder readings. Works on bytes, opens no ports."""

from __future__ import annotations

from .arduino_bridge import ArduinoBridge, ArduinoBridgeDevice
from .create2 import Create2, Create2Device
from .interface import Poll, Request, Reset, Stream, Velocity, WheelBase, WheelDevice, WheelReading
from .kinematics import DifferentialDrive, OdometryNoise
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
    "Odometer",
    "OdometryNoise",
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
