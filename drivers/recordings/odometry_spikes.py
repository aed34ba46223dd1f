"""Leave out single readings of odometry that the next reading takes back.

A damaged byte between the base and the computer, which no checksum guards, changes one coordinate of one reading. A
robot cannot move there and back within two readings: half of the detour over a reading is at most as long as brakes and
tyres allow.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from ..messages import Message, Odometry
from .time_ordering import AnomalyCounter

SPIKE = "odometry jumps and is back at its next reading; left out"
TOLERANCE = 0.2
"""Metres and radians that a reading may be off without being damaged: what a robot drives in a tenth of a second, by
which stamps may be wrong."""
ACCELERATION = 10.0
"""m/s² that tyres can transmit to the floor."""
TURN_ACCELERATION = 20.0
"""rad/s², the same for a robot that turns on the spot, whose wheels are half a metre apart."""


def without_spikes(messages: Iterable[Message], anomalies: AnomalyCounter) -> Iterator[Message]:
    """Yield messages, ordered by time, without such readings. A reading that may be one is held until the next one."""
    before: Odometry | None = None
    held: list[Message] = []  # from a suspicious reading on
    for message in messages:
        if not isinstance(message, Odometry):
            if held:
                held.append(message)
            else:
                yield message
            continue
        if held:
            reading = held[0]
            assert before is not None
            assert isinstance(reading, Odometry)
            if _is_spike(before, reading, message):
                anomalies.correct(SPIKE)
                del held[0]
            else:
                before = reading
            yield from held
            held = []
        if before is not None and _moves(before, message):
            held.append(message)
        else:
            before = message
            yield message
    yield from held


def _moves(before: Odometry, reading: Odometry) -> bool:
    """Return True if odometry moves farther than TOLERANCE."""
    return max(_motion(before, reading)) > TOLERANCE


def _is_spike(before: Odometry, reading: Odometry, after: Odometry) -> bool:
    """Return True if the way over a reading is longer than that from the one before it to the one after it."""
    times = (reading.stamp - before.stamp) * (after.stamp - reading.stamp)
    to, back, direct = _motion(before, reading), _motion(reading, after), _motion(before, after)
    limits = (max(TOLERANCE, 0.5 * acceleration * times) for acceleration in (ACCELERATION, TURN_ACCELERATION))
    return any(0.5 * (to[i] + back[i] - direct[i]) > limit for i, limit in enumerate(limits))


def _motion(first: Odometry, second: Odometry) -> tuple[float, float]:
    """Return the distance (metres) and the angle (radians) between two readings."""
    x, y, turn = (second.pose - first.pose).tolist()
    return math.hypot(x, y), abs(math.remainder(turn, 2.0 * math.pi))
