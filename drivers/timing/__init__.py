"""Timing errors of lidars, found in the data: reversed beam times, and a delay between lidar and odometry."""
