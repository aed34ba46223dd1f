"""Where measurements come from: recordings, simulations, devices. Knows nothing of features or SLAM."""
