"""Read the walls of a building from files of other programs: one module per format, all yield a `Plan`."""
