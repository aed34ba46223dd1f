"""What a robot measures, and the one protocol for where measurements come from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from .se2 import Pose

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One sweep of a 2-D lidar.

    stamp         seconds, when the first beam was measured
    ranges        (n,) metres; NaN where a beam returned nothing or nothing valid
    angles        (n,) radians in the lidar's frame, counter-clockwise, increasing
    time_offsets  (n,) seconds from the stamp to each beam; zeros where unknown. They decrease where the lidar
                  turns clockwise
    range_min, range_max  metres, what the sensor states (range_max may be inf)
    mount         [x, y, heading] of the lidar in the base's frame, T_base_lidar; None where the recording
                  does not say
    """

    stamp: float
    ranges: Floats
    angles: Floats
    time_offsets: Floats
    range_min: float
    range_max: float
    mount: Pose | None = None

    @property
    def duration(self) -> float:
        """Seconds from the first beam measured to the last, whichever way the lidar turns."""
        return float(self.time_offsets.max(initial=0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """The base's pose [x, y, heading] in the odometry's frame (metres, radians) at a stamp (seconds)."""

    stamp: float
    pose: Pose


@dataclass(frozen=True, slots=True, eq=False)
class GroundTruth:
    """The base's true pose [x, y, heading] in the world's frame at a stamp (seconds); simulations and motion
    capture have it.

    It is for evaluation and display only: nothing that estimates reads it.
    """

    stamp: float
    pose: Pose


Message: TypeAlias = Scan | Odometry | GroundTruth


def end_of(message: Message) -> float:
    """When the last of a message was measured (seconds)."""
    return message.stamp + float(message.time_offsets.max()) if isinstance(message, Scan) else message.stamp


@dataclass(slots=True)
class SourceReport:
    """What a source noticed while it was last read: what was skipped, and why. Complete once iteration has ended."""

    messages: int = 0
    skipped: int = 0
    reasons: dict[str, int] = field(default_factory=dict)  # reason -> how often
    first: str | None = None  # the first thing skipped, as `file:line: reason`


@runtime_checkable
class Source(Protocol):
    """Anything that yields messages in time order.

    A recording or a simulation can be iterated any number of times and gives the same messages each time.
    Iteration raises RecordingError where nothing sensible can be read; a single bad entry is skipped and
    counted in `report`.
    """

    name: str
    report: SourceReport

    def __iter__(self) -> Iterator[Message]:
        """The messages, from the beginning, stamps never decreasing."""
        ...

    def __len__(self) -> int:
        """About how many messages there are, for progress bars; 0 where unknown. Cheap."""
        ...
