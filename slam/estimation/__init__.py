"""Combine tracking, mapping and loop closure into one estimate that can be copied and restored."""
