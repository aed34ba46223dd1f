"""The errors a user of `slam` can meet; all are SlamError, all are one clear line."""

from __future__ import annotations

from pathlib import Path

from drivers.errors import DriverError, RecordingError, SlamError


class ConfigurationError(SlamError):
    """A setting is unknown or has no sensible value."""


class OutputError(SlamError):
    """Results cannot be written where they were asked for."""


class MapError(SlamError):
    """A map or trajectory file cannot be read, or the map cannot be estimated."""


class ClusterError(SlamError):
    """There is no cluster of workers where one was asked for."""


class PoseGraphError(SlamError):
    """A pose graph cannot be read or written. Carries the `path`, the `line` (from 1; None for the whole file) and the
    `reason`.
    """

    def __init__(self, path: Path, line: int | None, reason: str) -> None:
        self.path, self.line, self.reason = path, line, reason
        place = f"{path}:{line}" if line is not None else f"{path}"
        super().__init__(f"{place}: {reason}")


__all__ = [
    "ClusterError",
    "ConfigurationError",
    "DriverError",
    "MapError",
    "OutputError",
    "PoseGraphError",
    "RecordingError",
    "SlamError",
]
