"""How well, and how fast, features are found in simulated scans: what `wclm bench features` runs."""
