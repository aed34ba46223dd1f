"""A simulated robot behind two pseudo terminals: it speaks the bytes of a lidar and of a wheel base, at their pace.

    emulator   the whole: `Emulator`, stepped by a clock
    setup      what can be asked for, and the faults that happen at a time
    motion     the robot's true motion, made as time passes; who steers it
    keyboard   driving with the arrow keys
    optics     what a lidar measures from where the robot is
    wheels     what encoders count and gyros feel
    device     what all emulated devices have in common
    rplidar, rplidar_kinds, ld06, scip, base   the devices
    line       bytes at the pace of a baud rate, and what damages them
    port       a pseudo terminal under a name of the user's choice
    link       a device, its line and its port; what happens to them is counted
    truth      where the robot really was, as a file

Times are seconds since the emulator was started, on the host's steady clock; what a device calls time may drift.
"""

from __future__ import annotations

from .emulator import Emulator
from .emulator_setup import EmulatorSetup, FaultEvent, base_names, lidar_names

__all__ = ["Emulator", "EmulatorSetup", "FaultEvent", "base_names", "lidar_names"]
