"""Turn messages into processed scans: synchronise with odometry, de-skew, extract features."""
