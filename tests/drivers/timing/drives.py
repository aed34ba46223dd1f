"""Simulated drives whose timing is known."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import numpy as np

import drivers
from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan


@cache
def office_drive(seed: int = 0, seconds: float = 20.0) -> tuple[Message, ...]:
    """Return a drive through an office with a lidar that turns counter-clockwise, 5.5 times per second."""
    spec = f"sim:office?duration={seconds:g}&lidar=short&seed={seed}"
    return tuple(message for message in drivers.open(spec) if not isinstance(message, GroundTruth))


def mirrored(drive: tuple[Message, ...]) -> tuple[Message, ...]:
    """Return the drive in the mirrored world, in which the lidar turns clockwise."""
    result: list[Message] = []
    for message in drive:
        if isinstance(message, Scan):
            turned_round = {name: getattr(message, name)[::-1].copy() for name in ("ranges", "time_offsets")}
            assert message.mount is not None
            mount = message.mount * np.array([1.0, -1.0, -1.0])
            result.append(replace(message, angles=-message.angles[::-1], mount=mount, **turned_round))
        elif isinstance(message, Odometry):
            result.append(replace(message, pose=message.pose * np.array([1.0, -1.0, -1.0])))
    return tuple(result)


def with_late_scans(drive: tuple[Message, ...], seconds: float) -> list[Message]:
    """Return the drive with the stamps of scans moved, in time order."""
    moved = [replace(m, stamp=m.stamp + seconds) if isinstance(m, Scan) else m for m in drive]
    return sorted(moved, key=lambda message: message.stamp)


def with_few_returns(drive: Iterable[Message], every: int = 4, reach: float = 1.5) -> list[Message]:
    """Return the drive with a lidar that sees `reach` metres far, with one of so many beams: some 30 returns a scan."""
    few: list[Message] = []
    for message in drive:
        if isinstance(message, Scan):
            seen = (message.ranges < reach) & (np.arange(len(message.ranges)) % every == 0)
            message = replace(message, ranges=np.where(seen, message.ranges, np.nan))
        few.append(message)
    return few


def with_turned_lidar(drive: tuple[Message, ...], heading: float) -> list[Message]:
    """Return the drive of a robot on which the lidar has this heading, which the scans do not state."""
    turned: list[Message] = []
    for message in drive:
        if isinstance(message, Scan):
            turned.append(replace(message, mount=None))
        elif isinstance(message, Odometry):
            turned.append(replace(message, pose=se2.compose(message.pose, np.array([0.0, 0.0, -heading]))))
    return turned
