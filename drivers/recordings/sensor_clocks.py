"""Compare the clocks of the sensors of a recording.

A message has two times: its stamp, by the clock of the computer that read the sensor, and its reception, by the clock
of the recorder. A robot may have several computers, and not all know the time: a small one without a battery begins in
1970 or where it stopped, a simulator counts from zero. Then stamps of one sensor are years away from those of another.
How much later than its stamp a message is received differs between messages by the delays of transport, and between
clocks by a constant.

Several programs may publish on one topic with the same frame: a lidar, and a recording that is replayed meanwhile. Both
times tell them apart, too. A clock that is set makes the difference another one, once; between two sources it changes
whenever a message of one follows a message of the other.
"""

from __future__ import annotations

import struct
from array import array
from bisect import bisect
from collections.abc import Set
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

import numpy as np

from ..messages import Floats, Odometry, Scan, YawRate
from ..timestamps import to_seconds
from .point_clouds import POINT_CLOUD
from .ros_messages import IMU, LASER_SCAN, ODOMETRY, TRANSFORMS, TRANSFORMS_ROS1
from .stored_messages import StoredMessage
from .time_ordering import MAX_LATENESS
from .transforms import normalize_frame

MIN_DIFFERENCE = 5.0
"""Seconds between two clocks at least. Origin: chosen; computers that process a scan or a radio link with an even delay
take less, and stamps that are late for such a reason are right."""
EXTREMES = (1.0, 99.0)
"""Percentiles of the times from stamp to reception that are taken for their range. Origin: chosen, one message in a
hundred may have a wrong stamp."""
MAX_SPREAD = 0.5
"""Range of these times, as a share of the difference, up to which the difference is constant. Origin: geometry; the
ranges of two clocks are apart then."""
MIN_STANDING = 10
"""Messages with the first stamp of their stream from which its clock may stand, and messages of a source at least.
Origin: chosen; a few may be of one burst, or have wrong stamps."""
MAX_STREAMS = 1000
"""Streams that are compared. Origin: chosen, more than any robot has; the frames of a damaged recording are random."""
STAMPED = frozenset({LASER_SCAN, ODOMETRY, IMU, POINT_CLOUD})
"""Types of messages that begin with a header."""
MOVED = frozenset({TRANSFORMS, TRANSFORMS_ROS1})
"""Types of messages that are lists of transforms, each of which begins with a header."""

Stamped = TypeVar("Stamped", Scan, Odometry, YawRate)


class Stream(NamedTuple):
    """Messages from one sensor: their topic, the frame of their header, and for transforms the frame that they move.

    source  number of the program that publishes them, if there are several, see `SensorClocks.separate_sources`
    """

    topic: str
    frame: str
    child: str = ""
    source: int = 0


@dataclass(slots=True)
class SensorClocks:
    """Seconds from the stamp to the reception of the messages of each stream; zeros if its clock stands."""

    delays: dict[Stream, array[float]] = field(default_factory=dict)
    _first: dict[Stream, tuple[int, int]] = field(default_factory=dict)  # first stamp, and how often it came
    _limits: dict[Stream, list[float]] = field(default_factory=dict)  # seconds between the delays of several sources

    def add(self, stored: StoredMessage) -> None:
        """Add a message; those without a stamp, and those of streams beyond MAX_STREAMS, do not count."""
        found = _header(stored)
        if found is not None and found[0] and (found[1] in self.delays or len(self.delays) < MAX_STREAMS):
            nanoseconds, stream = found
            first, count = self._first.get(stream, (nanoseconds, 0))
            self._first[stream] = first, count + (nanoseconds == first)
            self.delays.setdefault(stream, array("d")).append((stored.received - nanoseconds) * 1e-9)

    def separate_sources(self) -> None:
        """Separate the messages of several sources on one topic with the same frames, after the last was added."""
        for stream, delays in list(self.delays.items()):
            limits = [] if self.stands(stream) else _limits_between_sources(np.frombuffer(delays))
            if limits:
                self._limits[stream] = limits
                for delay in self.delays.pop(stream):
                    source = stream._replace(source=bisect(limits, delay))
                    self._first[source] = 0, 0
                    self.delays.setdefault(source, array("d")).append(delay)

    def stream_of(self, stored: StoredMessage) -> Stream | None:
        """Return the stream of a message; None if it has no header."""
        found = _header(stored)
        if found is None:
            return None
        nanoseconds, stream = found
        limits = self._limits.get(stream)
        return stream._replace(source=bisect(limits, (stored.received - nanoseconds) * 1e-9)) if limits else stream

    def other_sources(self, topic: str | None, lidar: Stream) -> frozenset[Stream]:
        """Return the streams of a topic to be left out, since another source of the same has the clock of a lidar.

        If none has it, the source with the most messages is kept.
        """
        groups: dict[Stream, list[Stream]] = {}
        for stream in self.streams(topic):
            groups.setdefault(stream._replace(source=0), []).append(stream)
        others = set[Stream]()
        for sources in groups.values():
            kept = next((stream for stream in sources if not self.ahead(lidar, stream)), sources[0])
            others |= {stream for stream in sources if self.ahead(kept, stream)}
        return frozenset(others)

    def streams(self, topic: str | None) -> list[Stream]:
        """Return the streams of a topic, that with the most messages first."""
        return sorted((s for s in self.delays if s.topic == topic), key=lambda s: -len(self.delays[s]))

    def stands(self, stream: Stream | None) -> bool:
        """Return True if the clock of a stream stands: most of its messages have one stamp.

        They are as if they had none, and their times are those of reception.
        """
        if stream not in self.delays:
            return False
        count = self._first[stream][1]
        return count >= MIN_STANDING and 2 * count > len(self.delays[stream])

    def standing(self, topics: Set[str | None], frames: tuple[str, str] | None) -> frozenset[Stream]:
        """Return the streams whose clocks stand, of some topics and of the transforms between two frames."""
        read = (one for one in self.delays if one.topic in topics or (one.frame, one.child) == frames)
        return frozenset(stream for stream in read if self.stands(stream))

    def apart(self, topic: str | None) -> bool:
        """Return true if a topic has a stream of another clock than that with the most messages."""
        streams = self.streams(topic)
        return any(self.ahead(streams[0], other) for other in streams[1:])

    def shifts(self, lidar: Stream) -> dict[Stream, float]:
        """Return the seconds to be added to the stamps of each stream of another clock than a lidar's."""
        ahead = {stream: self.ahead(lidar, stream) for stream in self.delays if stream.topic != lidar.topic}
        return {stream: seconds for stream, seconds in ahead.items() if seconds}

    def ahead(self, one: Stream, other: Stream) -> float:
        """Return the seconds by which the clock of one stream is ahead of that of another; 0.0 if it is the same."""
        if one not in self.delays or other not in self.delays:
            return 0.0
        (low, median, high), (other_low, other_median, other_high) = self._range(one), self._range(other)
        difference = other_median - median
        spread = max(high - low, other_high - other_low)
        constant = spread <= MAX_SPREAD * abs(difference)
        return difference if abs(difference) >= MIN_DIFFERENCE and constant else 0.0

    def _range(self, stream: Stream) -> tuple[float, float, float]:
        if self.stands(stream):
            return 0.0, 0.0, 0.0
        low, high = EXTREMES
        values = np.percentile(np.frombuffer(self.delays[stream]), (low, 50.0, high))
        return float(values[0]), float(values[1]), float(values[2])


def restamped(message: Stamped, stored: StoredMessage, *, standing: bool) -> Stamped:
    """Return a message, which was decoded from a stored one, with the time of reception if its clock is `standing`."""
    return replace(message, stamp=to_seconds(stored.received)) if standing else message


def _limits_between_sources(delays: Floats) -> list[float]:
    """Return the delays (seconds, ascending) between those of sources that publish in turn; none for a single one.

    Sources that publish at random change more often, on average, than the rarer one has messages, and those that
    publish steadily nearly twice as often.

    delays  (n,) of the messages in the order of their reception
    """
    order = np.argsort(delays, kind="stable")
    steps = np.flatnonzero(np.diff(delays[order]) > MAX_LATENESS)
    if len(steps) == 0:
        return []
    limits = 0.5 * (delays[order[steps]] + delays[order[steps + 1]])
    side = np.searchsorted(limits, delays)
    before, after = np.minimum(side[:-1], side[1:]), np.maximum(side[:-1], side[1:])
    ends = len(limits) + 1
    changes = np.cumsum(np.bincount(before, minlength=ends) - np.bincount(after, minlength=ends))[:-1]
    rarer = np.minimum(steps + 1, len(delays) - steps - 1)
    return [float(limit) for limit in limits[(rarer >= MIN_STANDING) & (changes > rarer)]]


def _header(stored: StoredMessage) -> tuple[int, Stream] | None:
    """Return the stamp (nanoseconds) and the stream of a message, of a list of transforms those of the first."""
    moved = stored.msgtype in MOVED
    if not moved and stored.msgtype not in STAMPED:
        return None
    cdr = stored.encoding == "cdr"
    order = ">" if cdr and stored.data[1:2] == b"\0" else "<"
    # CDR has a head of four bytes, a list its length, and ROS 1 a sequence number in each header.
    at = 4 * cdr + 4 * moved + 4 * (not cdr)
    try:
        seconds, nanoseconds = struct.unpack_from(f"{order}iI", stored.data, at)
        frame, at = _string(stored.data, at + 8, order)
        child = _string(stored.data, at + (-at % 4 if cdr else 0), order)[0] if moved else ""
    except (struct.error, UnicodeDecodeError):
        return None
    return seconds * 10**9 + nanoseconds, Stream(stored.topic, normalize_frame(frame), normalize_frame(child))


def _string(data: bytes, at: int, order: str) -> tuple[str, int]:
    """Return the string at a place of serialised data, and the place after it."""
    (length,) = struct.unpack_from(f"{order}I", data, at)
    end = at + 4 + length
    if end > len(data):
        raise struct.error("string is cut short")
    return data[at + 4 : end].rstrip(b"\0").decode(), end
