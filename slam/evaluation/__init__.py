"""Score trajectories and covariances, and run the benchmarks."""
