"""Requests to the run of the node, handed from the threads of the services to its thread; most of them end it."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from drivers import se2
from drivers.immutable import immutable

if TYPE_CHECKING:
    from ..io.sessions import StoredSession

TIMEOUT = 120.0
"""Seconds that a request may take: longer than to finish the map of hours of driving."""


@dataclass(frozen=True, slots=True)
class Save:
    """Finish the map, write it to a directory, and continue it."""

    directory: Path


@immutable
class Restart:
    """Discard the map and begin with a session, or with an empty map; see `RunSetup` for the members."""

    session: StoredSession | None
    frozen: bool
    pose: se2.Pose | None = None


@dataclass(frozen=True, slots=True)
class SetMode:
    """Only localise in the map, which stays as it is (`frozen`), or extend it."""

    frozen: bool


Request: TypeAlias = Save | Restart | SetMode


class RestartRequestedError(Exception):
    """The run ends here, and its results are not wanted."""


class RunControl:
    """Place for one request at a time.

    pending  request that the run has to carry out, if any
    """

    def __init__(self) -> None:
        self.pending: Request | None = None
        self._one_at_a_time, self._done = threading.Lock(), threading.Event()
        self._succeeded = False

    def request(self, request: Request) -> bool:
        """Hand a request to the run and wait until it is done; return True if it succeeded."""
        with self._one_at_a_time:
            self._done.clear()
            self.pending = request
            return self._done.wait(TIMEOUT) and self._succeeded

    def answer(self, succeeded: bool) -> None:
        """State that the pending request is done."""
        self.pending, self._succeeded = None, succeeded
        self._done.set()
