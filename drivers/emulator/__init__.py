"""A simulated robot behind two pseudo terminals: the bytes of a lidar and of a wheel base, at their original pace.

    emulator         the whole: `Emulator`, stepped by a clock
    emulator_setup   the settings, and the scheduled faults
    robot_motion     the robot's true motion, computed as time passes, and its pilots
    keyboard         driving with the arrow keys
    beam_model       ranges that a lidar measures from the robot's position
    wheel_sensors    encoder counts and gyro headings
    device           common part of all emulated devices
    rplidar, rplidar_variants, rplidar_scan, ld06, scip, wheel_base   the devices
    serial_line      bytes at the pace of a baud rate, and their corruption
    pty_port         a pseudo terminal with a name of the user's choice
    connection       a device, its line and its port, with counts
    ground_truth     the true path, as a file

Times are seconds since the emulator was started, on the host's steady clock; a device's own clock may drift.
"""

from __future__ import annotations

from .emulator import Emulator
from .emulator_setup import EmulatorSetup, FaultEvent, base_names, lidar_names

__all__ = ["Emulator", "EmulatorSetup", "FaultEvent", "base_names", "lidar_names"]
