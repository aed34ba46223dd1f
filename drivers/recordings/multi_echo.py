"""Scans with several echoes per beam, as Hokuyo lidars measure through glass and at edges: the first echo is read."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .ros_messages import LASER_SCAN
from .stored_messages import StoredMessage

MULTI_ECHO = "sensor_msgs/msg/MultiEchoLaserScan"

_FRAME_LENGTH = 12
"""Offset of the length of the frame's name, bytes: in both encodings after three numbers of 32 bits."""
_SCALARS = 7 * 4
"""Bytes of the angles, times and limits between the frame's name and the echoes."""


def first_echoes(stored: StoredMessage) -> StoredMessage:
    """Return a MultiEchoLaserScan as a LaserScan with the first echo of each beam, NaN for a beam without any.

    The first echo is the nearest: glass, behind which others lie. Both messages begin alike, so only the lists of
    echoes are rewritten. A message that is cut short becomes an empty one, which is counted as damaged if it is read.
    """
    try:
        start = _echoes_start(stored)
        ranges, after = _first(stored.data, start)
        intensities, _ = _first(stored.data, after)
    except (struct.error, IndexError):
        return replace(stored, msgtype=LASER_SCAN, data=b"")
    return replace(stored, msgtype=LASER_SCAN, data=stored.data[:start] + _sequence(ranges) + _sequence(intensities))


def _echoes_start(stored: StoredMessage) -> int:
    """Return the offset of the echoes of the ranges; raises struct.error or IndexError if the message is too short."""
    data = stored.data
    if stored.encoding == "cdr" and data[1] != 1:
        raise IndexError("not in little-endian order")
    (length,) = struct.unpack_from("<I", data, _FRAME_LENGTH)
    end: int = _FRAME_LENGTH + 4 + length
    return (end + -end % 4 if stored.encoding == "cdr" else end) + _SCALARS


def _first(data: bytes, start: int) -> tuple[NDArray[np.float32], int]:
    """Return the first echo (n,) of each of the beams listed at an offset, and the offset after them.

    Raises struct.error or IndexError if the data ends before.
    """
    (beams,) = struct.unpack_from("<I", data, start)
    at = start + 4
    words = np.frombuffer(data, "<u4", (len(data) - at) // 4, at)
    listed = words.tolist()  # of each beam the number of its echoes, and these
    first = np.empty(min(beams, len(listed)), dtype=np.int64)
    word = 0
    for beam in range(beams):
        echoes = listed[word]
        first[beam] = word + 1 if echoes else -1
        word += 1 + echoes
    if word > len(listed):
        raise IndexError("fewer echoes than stated")
    ranges = words.view("<f4")[first] if beams else np.empty(0, dtype=np.float32)
    ranges[first < 0] = np.nan
    return ranges, at + 4 * word


def _sequence(values: NDArray[np.float32]) -> bytes:
    return struct.pack("<I", len(values)) + values.astype("<f4").tobytes()
