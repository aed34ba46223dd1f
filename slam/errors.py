"""Errors that users of `slam` can encounter; all are SlamError with a message of one line."""

from __future__ import annotations

from pathlib import Path

from drivers.errors import ArgumentError, DriverError, MessageError, RecordingError, SlamError

MAX_LENGTH = 300
"""Characters of an error of a library that are repeated: some contain the damaged file."""


class ConfigurationError(SlamError):
    """A setting is unknown or its value is invalid."""


class OutputError(SlamError):
    """Results cannot be written to the requested place."""


class MapError(SlamError):
    """A map or trajectory cannot be read, or a map cannot be estimated."""


class ClusterError(SlamError):
    """The cluster of workers cannot be reached."""


class MissingExtraError(SlamError):
    """A package of an extra is not installed."""

    def __init__(self, extra: str, package: str) -> None:
        super().__init__(f"{package} is not installed; needs the extra '{extra}': pip install 'wclm-slam[{extra}]'")


class PoseGraphError(SlamError):
    """A pose graph cannot be read or written.

    path, line  file and line, from 1; None for the whole file
    reason      text of the error without the place
    """

    def __init__(self, path: Path, line: int | None, reason: str) -> None:
        self.path, self.line, self.reason = path, line, reason
        place = f"{path}:{line}" if line is not None else f"{path}"
        super().__init__(f"{place}: {reason}")


def first_line(error: BaseException) -> str:
    """Return the first line of an error's text that is not empty, cut to MAX_LENGTH, else the name of its type."""
    text = next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
    return shortened(text)


def shortened(text: str) -> str:
    """Return a text as one line, cut to MAX_LENGTH."""
    line = " ".join(text.split())
    return line if len(line) <= MAX_LENGTH else line[: MAX_LENGTH - 1] + "…"


__all__ = [
    "ArgumentError",
    "ClusterError",
    "ConfigurationError",
    "DriverError",
    "MapError",
    "MessageError",
    "MissingExtraError",
    "OutputError",
    "PoseGraphError",
    "RecordingError",
    "SlamError",
    "first_line",
    "shortened",
]
