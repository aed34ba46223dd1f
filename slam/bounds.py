"""Bounds of settings, and of the values in sessions: what a drive was mapped with can be read again."""

from __future__ import annotations

import math

MAX_LENGTH = 1e10
"""Largest absolute value of a length, metres, or angle, radians: odometry of recordings has up to 1e9."""
MAX_MAGNITUDE = 1e15
"""Largest absolute value of any other number, such as stamps, covariances and informations. Its square is finite."""
MIN_DEVIATION, MAX_DEVIATION = 1e-9, 1e5
"""Smallest and largest standard deviation of a measurement, metres or radians: none is as precise, and beside one that
is less precise the others would be lost in rounding.
"""
MAX_ODOMETRY_DEVIATION = 1000.0
"""Largest standard deviation of odometry in the settings, metres or radians. A larger one is not needed to say that
odometry is useless.
"""
MAX_RANGE = 1e4
"""Largest range of a lidar, metres: they measure some hundred."""
MAX_MOUNT = 100.0
"""Largest distance of a lidar from the origin of the base along x or y, metres."""
MAX_TURN = 2.0 * math.pi
"""Largest angle of a lidar's mount, radians; a larger one is in degrees."""
MAX_COORDINATE = 1e5
"""Largest coordinate of a feature in the frame of the base, metres: more than MAX_RANGE and MAX_MOUNT together."""
MAX_PERIOD = 1e6
"""Largest period or delay of the node of ROS 2, seconds; stamps and timers have limits, too."""
