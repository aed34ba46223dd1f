"""Read and write recordings: CARMEN logs, ROS 1 and 2 bags, MCAP files."""
