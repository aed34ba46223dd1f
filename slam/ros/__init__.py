"""What a SLAM node of ROS 2 takes and publishes; `drivers.ros2` has the link to ROS 2 itself."""
