"""The errors a user of `slam` can meet; all are SlamError, all are one clear line."""

from __future__ import annotations

from drivers.errors import DriverError, RecordingError, SlamError


class ConfigurationError(SlamError):
    """A setting is unknown or has no sensible value."""


class OutputError(SlamError):
    """Results cannot be written where they were asked for."""


class MapError(SlamError):
    """A map or trajectory file cannot be read, or the map cannot be estimated."""


__all__ = ["ConfigurationError", "DriverError", "MapError", "OutputError", "RecordingError", "SlamError"]
