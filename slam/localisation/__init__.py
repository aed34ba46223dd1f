"""Track the pose from scan to scan and classify how well it is known."""
