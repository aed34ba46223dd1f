"""What a node does not receive from ROS 2, or cannot use, as texts for the user."""

from __future__ import annotations

import time
from collections.abc import Collection

from .inputs import Inputs

SILENCE = 5.0
"""Seconds without any message of a kind after which it is missing."""


class Silence:
    """Times of the last messages of each kind, and the frames of scans without a transform to the base.

    unconnected  these frames
    """

    def __init__(self, lidars: int) -> None:
        """Expect scans of so many lidars, and odometry, from now on."""
        self.unconnected: set[str] = set()
        self._scans, self._odometry = [time.monotonic() for _ in range(lidars)], time.monotonic()

    def scan_arrived(self, lidar: int) -> None:
        """Note that a scan of a lidar has arrived."""
        self._scans[lidar] = time.monotonic()

    def odometry_arrived(self) -> None:
        """Note that odometry has arrived."""
        self._odometry = time.monotonic()

    def missing(self, inputs: Inputs, others: Collection[str]) -> list[str]:
        """Return a line of text for each input that has not arrived for SILENCE seconds.

        others  frames to which odometry's frame has transforms, instead of that of the base
        """
        now = time.monotonic()
        silent = zip(inputs.scan_topics, self._scans, strict=True)
        lines = [f"no scans on {topic}" for topic, last in silent if now - last > SILENCE]
        if inputs.uses_odometry and now - self._odometry > SILENCE:
            lines.append(_missing_odometry(inputs, others))
        return lines

    def unusable(self, inputs: Inputs) -> list[str]:
        """Return a line of text for each frame of scans that are dropped for lack of a transform."""
        return [
            f"no transform {inputs.base_frame} -> {frame}; scans are dropped until there is one"
            for frame in sorted(self.unconnected)
        ]


def _missing_odometry(inputs: Inputs, others: Collection[str]) -> str:
    if inputs.base:
        return f"no odometry from {inputs.base}"
    if inputs.odometry:
        return f"no odometry on {inputs.odometry}"
    hint = f", but to {', '.join(sorted(others))}: is base_frame set correctly?" if others else ""
    return f"no transform {inputs.odometry_frame} -> {inputs.base_frame} on {inputs.transforms}{hint}"
