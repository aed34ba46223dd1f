"""Leave out copies of scans.

Some recordings contain each scan more than once with one stamp: a driver was started twice, a relay publishes to the
same topic, or two recordings of one drive were joined. A copy is no measurement; estimates would be too certain by it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from ..messages import Message, Scan
from .time_ordering import AnomalyCounter

COPY = "copy of another scan; left out"


def without_copies(messages: Iterable[Message], anomalies: AnomalyCounter) -> Iterator[Message]:
    """Yield messages, ordered by time, without scans that equal another one of the same lidar, mount and stamp."""
    stamp = float("nan")
    scans: list[Scan] = []  # those that were yielded with this stamp
    for message in messages:
        if isinstance(message, Scan):
            if message.stamp != stamp:
                stamp, scans = message.stamp, []
            if any(_is_copy(message, scan) for scan in scans):
                anomalies.skip(None, COPY)
                continue
            scans.append(message)
        yield message


def _is_copy(scan: Scan, other: Scan) -> bool:
    if scan.lidar != other.lidar or (scan.mount is None) != (other.mount is None):
        return False
    same_mount = scan.mount is None or np.array_equal(scan.mount, other.mount)  # type: ignore[arg-type]
    return (
        same_mount
        and np.array_equal(scan.ranges, other.ranges, equal_nan=True)
        and np.array_equal(scan.angles, other.angles)
    )
