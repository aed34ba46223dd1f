"""What a run reports: events for its sinks, its localisation status, and counts and times for its summary."""
