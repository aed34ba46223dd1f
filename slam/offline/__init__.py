"""Process recorded sessions: map merging, calibration and batches of recordings."""
