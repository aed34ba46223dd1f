"""Base class of all errors of the project, and the errors of recordings and devices."""

from __future__ import annotations

from pathlib import Path

MAX_HALF_TEXT = 500
"""Characters at the beginning and at the end of an error's text that are shown if it is longer than both."""


class SlamError(Exception):
    """Error that the user can correct. Its text is one line; the command line prints it and exits with status 2.

    Names and numbers in a damaged file may be of any length, and contain line breaks and control characters: the text
    is shortened in its middle, and these characters are replaced.
    """

    def __str__(self) -> str:
        """Return the text."""
        text = super().__str__()
        if len(text) > 2 * MAX_HALF_TEXT:
            text = f"{text[:MAX_HALF_TEXT]} ... {text[-MAX_HALF_TEXT:]}"
        return "".join(character if character.isprintable() else "\N{REPLACEMENT CHARACTER}" for character in text)


class RecordingError(SlamError):
    """Recording that cannot be read or written.

    path    of the recording
    line    line or message number, 1-based; None for the whole file
    reason  one line of text
    """

    def __init__(self, path: str | Path, line: int | None, reason: str) -> None:
        self.path, self.line, self.reason = Path(path), line, reason
        place = f"{path}:{line}" if line is not None else f"{path}"
        super().__init__(f"{place}: {reason}")


class ArgumentError(SlamError):
    """Argument of a function with a wrong type."""


class MessageError(SlamError):
    """Message that a program has made with a wrong type, shape, order or value."""


class DriverError(SlamError):
    """Device that violates its protocol."""


class PortError(DriverError):
    """Port that cannot be opened: `port` is its name, `reason` one line of text."""

    def __init__(self, port: str, reason: str) -> None:
        self.port, self.reason = port, reason
        super().__init__(f"{port}: {reason}")


class ConnectionLostError(PortError):
    """Open port that was lost: unplugged, closed by the other side, or not accepting bytes any more."""


class EndOfCaptureError(ConnectionLostError):
    """End of a byte capture that is played."""


class NoResponseError(PortError):
    """Port that can be opened, but at which the expected device does not respond."""
