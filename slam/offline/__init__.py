"""Process recorded sessions: refinement, map merging and comparison, corrections, calibration, batches."""
