"""Simulated drives as recordings, so that the readers' corrections of defects take part in a benchmark."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

import drivers
from drivers.messages import Message, Scan, Source
from drivers.recordings.mcap import McapWriter


@contextmanager
def recorded(messages: Iterable[Message]) -> Iterator[Source]:
    """Write messages to a temporary recording and provide its reader.

    Ranges and their limits are rounded to 32-bit floats, as in the messages of ROS; otherwise the writer would store
    them exactly, and the reader would not check them.
    """
    with tempfile.TemporaryDirectory(prefix="wclm-") as folder:
        file = Path(folder) / "drive.mcap"
        with McapWriter(file) as writer:
            for message in messages:
                writer.write(_rounded(message))
        yield drivers.open(file)


def _rounded(message: Message) -> Message:
    if not isinstance(message, Scan):
        return message
    ranges = message.ranges.astype(np.float32).astype(np.float64)
    low, high = (float(np.float32(limit)) for limit in (message.range_min, message.range_max))
    return replace(message, ranges=ranges, range_min=low, range_max=high)
