"""Wheel odometry: the readings, and a model of their errors that is learned while driving."""
