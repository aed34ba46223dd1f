"""Live connection with ROS 2 by packages from PyPI, or by rclpy if ROS 2 is sourced; see `link` for the interface."""
