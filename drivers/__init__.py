"""Sources of measurements: recordings, simulations and devices. Independent of `features` and `slam`.

`open` returns the source that a path or specification refers to::

    for message in drivers.open("intel.clf"):
        ...
"""

from __future__ import annotations

from .errors import DriverError, RecordingError, SlamError
from .messages import GroundTruth, Message, Odometry, Scan, Source, SourceReport
from .recordings.inspection import RecordingInfo, inspect
from .source_factory import open

__all__ = [
    "DriverError",
    "GroundTruth",
    "Message",
    "Odometry",
    "RecordingError",
    "RecordingInfo",
    "Scan",
    "SlamError",
    "Source",
    "SourceReport",
    "inspect",
    "open",
]
