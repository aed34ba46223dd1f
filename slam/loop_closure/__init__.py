"""Place recognition after drift, and loop closure."""
