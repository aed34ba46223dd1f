"""Benchmarks of the extraction on simulated scans: accuracy, time and start-up, run by `wclm bench features`."""
