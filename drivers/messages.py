"""Measurements of a robot, and the protocol that all sources of measurements implement."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from .immutable import immutable
from .se2 import Pose

Floats = NDArray[np.float64]

MAX_SPAN = 4.0 * math.pi
"""Radians from the first beam of a scan to the last at most: it covers about one turn. In degrees it would cover more.
"""
MAX_TURN_PERIOD = 10.0
"""Seconds in which a lidar turns once at most. Origin: data sheets; they turn several times in a second."""


@immutable
class Scan:
    """One sweep of a 2-D lidar.

    stamp         time of the first measured beam, seconds
    ranges        (n,) metres; NaN for no-returns and invalid ranges, as which those count that are less than range_min,
                  or not less than range_max
    angles        (n,) radians in the lidar's frame, counter-clockwise, increasing
    time_offsets  (n,) seconds from the stamp to each beam; zeros if unknown. They decrease if the lidar rotates
                  clockwise
    range_min, range_max  limits that the sensor states, metres (range_max may be inf)
    mount         [x, y, heading] of the lidar in the base's frame, T_base_lidar; None if unknown
    lidar         number of the lidar on the robot: 0 for the first, which is the only one on most, 1 for the second
    intensities   (n,) strengths of the returns in the lidar's own unit, higher is stronger; None if unknown. For
                  display only, never used by the estimator
    """

    stamp: float
    ranges: Floats
    angles: Floats
    time_offsets: Floats
    range_min: float
    range_max: float
    mount: Pose | None = None
    lidar: int = 0
    intensities: Floats | None = None

    @property
    def duration(self) -> float:
        """Seconds from the first measured beam to the last, for either direction of rotation."""
        return float(self.time_offsets.max(initial=0.0))


@immutable
class Odometry:
    """Pose [x, y, heading] of the base in the odometry's frame (metres, radians) at a stamp (seconds)."""

    stamp: float
    pose: Pose


@immutable
class YawRate:
    """Rate (radians per second) at which the base turns counter-clockwise, as a gyroscope measures it, at a stamp."""

    stamp: float
    rate: float


@immutable
class InitialPose:
    """Pose [x, y, heading] of the base in the map (metres, radians), roughly, as a user set it at a stamp (seconds)."""

    stamp: float
    pose: Pose


@immutable
class GroundTruth:
    """True pose [x, y, heading] of the base in the world's frame (metres, radians) at a stamp (seconds).

    Available from simulations and motion capture. It is used for evaluation and display only, never by the estimator.
    """

    stamp: float
    pose: Pose


Message: TypeAlias = Scan | Odometry | YawRate | InitialPose | GroundTruth


def with_reversed_times(scan: Scan) -> Scan:
    """Return a scan whose beams were measured in the opposite order, within the same time."""
    offsets = scan.time_offsets
    return replace(scan, time_offsets=offsets.max() + offsets.min() - offsets) if len(offsets) else scan


def mirrored(scan: Scan) -> Scan:
    """Return a scan as of a lidar that was turned over about the axis that points ahead."""
    return replace(
        scan,
        ranges=scan.ranges[::-1],
        angles=-scan.angles[::-1],
        time_offsets=scan.time_offsets[::-1],
        intensities=None if scan.intensities is None else scan.intensities[::-1],
    )


def delay_odometry(message: Message, seconds: float) -> Message:
    """Return the message on the lidar's clock: stamps of odometry, gyroscope and true poses are moved by the delay.

    seconds  by which the stamps of scans are late; they stay, and with them whatever refers to a scan by its stamp
    """
    moved = seconds and isinstance(message, Odometry | YawRate | GroundTruth)
    return replace(message, stamp=message.stamp + seconds) if moved else message


def on_clock_of_first(message: Message, seconds: float) -> Message:
    """Return the message with the stamp on the first lidar's clock; only scans of a second lidar are changed.

    seconds  by which the second lidar's stamps are later than the first's
    """
    moved = seconds and isinstance(message, Scan) and message.lidar
    return replace(message, stamp=message.stamp - seconds) if moved else message


def end_stamp(message: Message) -> float:
    """Return the time of a message's last measurement (seconds): of a scan's last beam, else its stamp."""
    return message.stamp + float(message.time_offsets.max()) if isinstance(message, Scan) else message.stamp


@dataclass(slots=True)
class SourceReport:
    """Counts of the last iteration over a source: messages, and what was skipped and why. Complete when it has ended.

    messages         number of messages yielded
    skipped          number of entries skipped
    reasons          number of times that each reason for skipping occurred
    first            first skipped entry, as `file:line: reason`
    corrected        number of times that each correction without loss occurred, such as the sorting of messages
    interpretations  how the content was read where that had to be found out: a topic, a unit, etc.; one line each
    doubts           what is probably wrong with the content, which was read as it is; one line each
    recorded_stamps  stamp as read -> stamp as recorded, seconds, for stamps that were recorded wrongly and restored
    scan_topic       topic of the scans; None if there is none, as in formats without topics
    odometry_topic   the same of odometry; None also for odometry from transforms, which is an interpretation
    gyroscope_topic  the same of the rates of a gyroscope
    """

    messages: int = 0
    skipped: int = 0
    reasons: dict[str, int] = field(default_factory=dict)
    first: str | None = None
    corrected: dict[str, int] = field(default_factory=dict)
    interpretations: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    recorded_stamps: dict[float, float] = field(default_factory=dict)
    scan_topic: str | None = None
    odometry_topic: str | None = None
    gyroscope_topic: str | None = None


@runtime_checkable
class Source(Protocol):
    """Source of messages in time order.

    A recording or a simulation can be iterated any number of times and yields the same messages each time. Iteration
    raises RecordingError if nothing can be read; a single bad entry is skipped and counted in `report`.
    """

    name: str
    report: SourceReport

    def __iter__(self) -> Iterator[Message]:
        """Yield the messages from the beginning, with non-decreasing stamps."""
        ...

    def __len__(self) -> int:
        """Return the approximate number of messages, for progress bars; 0 if unknown. Fast."""
        ...
