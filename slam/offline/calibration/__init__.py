"""Calibrate the lidar's mount and range bias, and the odometry's scales, from a recording."""
