"""The pump: messages are seen when they arrive, and handed on completely, with the error that ended them."""

from __future__ import annotations

import threading
from collections import deque

import numpy as np
import pytest

from drivers.errors import DriverError
from drivers.messages import Message, Odometry
from slam.cli.acquisition_loop import receive_messages
from slam.cli.message_pump import CAPACITY, MessagePump


class Source:
    """A receiver with a number of messages, which then fails or ends."""

    def __init__(self, count: int, failure: DriverError | None = None) -> None:
        self.messages: deque[Message] = deque(Odometry(float(k), np.zeros(3)) for k in range(count))
        self.failure, self.stopped = failure, False

    @property
    def ended(self) -> bool:
        return not self.messages and self.failure is None

    def receive(self, timeout: float) -> Message | None:
        if self.messages:
            return self.messages.popleft()
        assert self.failure is not None
        raise self.failure

    def stop(self) -> None:
        self.stopped = True


def test_messages_are_seen_while_the_consumer_is_busy_and_handed_on_in_order() -> None:
    seen, all_seen = [], threading.Event()

    def arrived(message: Message) -> None:
        seen.append(message.stamp)
        if len(seen) == CAPACITY:
            all_seen.set()

    with MessagePump(Source(CAPACITY + 100), arrived) as pump:
        assert all_seen.wait(30.0)  # although none was received
        stamps = []
        while not pump.ended:
            if (message := pump.receive(0.1)) is not None:
                stamps.append(message.stamp)
    assert stamps == seen == [float(k) for k in range(CAPACITY + 100)]


def test_an_error_follows_the_last_message() -> None:
    source, received = Source(5, DriverError("unplugged")), []
    with MessagePump(source, lambda message: None) as pump:
        with pytest.raises(DriverError, match="unplugged"):
            received.extend(receive_messages(pump, None, lambda: None))
        assert pump.ended
        pump.stop()
    assert (len(received), source.stopped) == (5, True)


def test_it_ends_although_nobody_receives() -> None:
    full = threading.Event()

    def arrived(message: Message) -> None:
        if message.stamp == CAPACITY:  # the queue takes no further one
            full.set()

    source = Source(2 * CAPACITY)
    with MessagePump(source, arrived):
        assert full.wait(30.0)
    assert source.messages  # the thread has ended while it waited to hand on a message
