"""The root of the project's one tree of errors, and the branch that recordings and devices raise."""

from __future__ import annotations

from pathlib import Path


class SlamError(Exception):
    """Anything a user can mend. Its text is one line that names the place; the command line prints it and
    exits with 2.
    """


class RecordingError(SlamError):
    """A recording cannot be read. Carries the `path`, the `line` or message number (1-based, None for the
    whole file) and the `reason`.
    """

    def __init__(self, path: str | Path, line: int | None, reason: str) -> None:
        self.path, self.line, self.reason = Path(path), line, reason
        place = f"{path}:{line}" if line is not None else f"{path}"
        super().__init__(f"{place}: {reason}")


class DriverError(SlamError):
    """A device does not do what its protocol says."""


class PortError(DriverError):
    """A port cannot be opened. Carries the `port` and the `reason`."""

    def __init__(self, port: str, reason: str) -> None:
        self.port, self.reason = port, reason
        super().__init__(f"{port}: {reason}")


class ConnectionLostError(PortError):
    """A port that was open is gone: unplugged, closed by the other side, or no longer taking bytes."""


class EndOfCaptureError(ConnectionLostError):
    """A tape of raw bytes was played to its end."""


class NoAnswerError(PortError):
    """A port can be opened, but what was expected there does not answer."""
