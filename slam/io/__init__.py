"""Read and write trajectories, maps, sessions and output directories."""
