"""Choose between several sources of scans on one topic of a recording, which have different clocks.

A simulator that was left running publishes on the topic of a lidar, or a recording is replayed while a lidar runs. Two
lidars of one clock are both read.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress

from .ros_messages import LASER_SCAN, LidarMount, decode, scan_of
from .scan_topics import ScanTopic
from .sensor_clocks import SensorClocks, Stream
from .stored_messages import StoredMessage


def choose_scan_source(
    messages: Iterable[StoredMessage], topic: str, clocks: SensorClocks, odometry: Sequence[Stream]
) -> tuple[frozenset[Stream], str]:
    """Return the streams on a topic that are left out, and the reason as a line of text.

    The source with scans of the best quality is kept, one on whose clock there is odometry if any.

    messages  of the recording; the topic has LaserScans of several clocks
    odometry  streams of the odometry
    """
    candidates = {stream: ScanTopic(stream.frame) for stream in clocks.streams(topic)}
    for stored in messages:
        if stored.msgtype == LASER_SCAN and (stream := clocks.stream_of(stored)) in candidates:
            with suppress(ValueError):  # counted when the recording is read
                message = decode(stored.data, LASER_SCAN, stored.encoding)
                candidates[stream].add(scan_of(message, stored.received, LidarMount()))

    def rank(stream: Stream) -> tuple[bool, float]:
        return any(not clocks.ahead(stream, other) for other in odometry), candidates[stream].quality

    lidar = max(candidates, key=rank)
    foreign = frozenset(stream for stream in candidates if clocks.ahead(lidar, stream))
    others = "; ".join(
        f"{_name(stream, lidar, clocks)}: {scans.describe()}"
        for stream, scans in candidates.items()
        if stream in foreign
    )
    several = any(stream[:3] == lidar[:3] for stream in foreign)
    return foreign, (
        f"{f'several sources publish on {topic}, as a lidar and a replayed recording do; ' if several else ''}"
        f"scans of {topic} with the frame {lidar.frame}: {candidates[lidar].describe()} "
        f"(left out, since they have another clock: {others})"
    )


def _name(stream: Stream, lidar: Stream, clocks: SensorClocks) -> str:
    """Return the frame of a stream, or by how much its clock differs if the frame is that of the lidar."""
    if stream.frame != lidar.frame:
        return stream.frame
    ahead = clocks.ahead(lidar, stream)
    return f"stamped {abs(ahead):.1f} s {'earlier' if ahead > 0.0 else 'later'}"
