"""Sources of measurements: recordings, simulations and devices. Independent of `features` and `slam`.

`open` returns the source that a path or specification refers to::

    for message in drivers.open("intel.clf"):
        ...
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .errors import DriverError, RecordingError, SlamError
    from .messages import GroundTruth, InitialPose, Message, Odometry, Scan, Source, SourceReport, YawRate
    from .recordings.inspection import RecordingInfo, inspect
    from .source_factory import open

__all__ = [
    "DriverError",
    "GroundTruth",
    "InitialPose",
    "Message",
    "Odometry",
    "RecordingError",
    "RecordingInfo",
    "Scan",
    "SlamError",
    "Source",
    "SourceReport",
    "YawRate",
    "inspect",
    "open",
]

_MODULES = {
    "DriverError": "errors",
    "GroundTruth": "messages",
    "InitialPose": "messages",
    "Message": "messages",
    "Odometry": "messages",
    "RecordingError": "errors",
    "RecordingInfo": "recordings.inspection",
    "Scan": "messages",
    "SlamError": "errors",
    "Source": "messages",
    "SourceReport": "messages",
    "YawRate": "messages",
    "inspect": "recordings.inspection",
    "open": "source_factory",
}


def __getattr__(name: str) -> Any:
    # Imported on first use: the command line needs the errors to print its help, but not NumPy, which takes longer to
    # load than everything else for that.
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_MODULES[name]}", __name__), name)
