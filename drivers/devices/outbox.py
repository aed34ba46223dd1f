"""Queue between the reading process and its consumer, which may be slow or stopped without delaying the reading."""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from multiprocessing.connection import Connection
from threading import Condition, Thread

from ..messages import Message
from .snapshot import Snapshot

CAPACITY = 20_000
"""Messages that wait for a slow consumer: four minutes of a lidar and a wheel base, about 60 MB."""


class Outbox:
    """Sender of messages and snapshots in a thread of its own.

    dropped  messages dropped for lack of room, the oldest first
    broken   True if the consumer has ended
    """

    def __init__(self, pipe: Connection, capacity: int = CAPACITY) -> None:
        self.dropped = 0
        self.broken = False
        self._pipe, self._capacity = pipe, capacity
        self._messages: deque[Message] = deque()
        self._snapshot: Snapshot | None = None
        self._closed = False
        self._changed = Condition()
        self._thread = Thread(target=self._send, name="outbox", daemon=True)
        self._thread.start()

    def put(self, message: Message) -> None:
        """Queue a message."""
        with self._changed:
            self._messages.append(message)
            if len(self._messages) > self._capacity:
                self._messages.popleft()
                self.dropped += 1
            self._changed.notify()

    def put_snapshot(self, snapshot: Snapshot) -> None:
        """Queue a snapshot, in place of one that is still waiting; it is sent before waiting messages."""
        with self._changed:
            self._snapshot = snapshot
            self._changed.notify()

    def close(self) -> None:
        """Wait until everything is sent, or the consumer has ended."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()

    def _send(self) -> None:
        with suppress(EOFError, OSError):  # the consumer has ended
            while (item := self._next()) is not None:
                self._pipe.send(item)
            return
        self.broken = True

    def _next(self) -> Message | Snapshot | None:
        """Wait for the next item and return it; None at the end."""
        with self._changed:
            while not (self._snapshot or self._messages or self._closed):
                self._changed.wait()
            if self._snapshot is not None:
                snapshot, self._snapshot = self._snapshot, None
                return snapshot
            return self._messages.popleft() if self._messages else None
