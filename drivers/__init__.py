"""Where measurements come from: recordings, simulations, devices. Knows nothing of features or SLAM.

`open` turns what a user types into a source of messages::

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
