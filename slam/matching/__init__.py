"""Match a scan to the local map: line registration and the likelihood field of raw points."""
