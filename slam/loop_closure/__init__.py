"""Place recognition after drift, loop closure, and relocalisation in a known map."""
