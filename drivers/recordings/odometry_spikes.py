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
MAX_SHARE = 0.1
"""Share of the readings that are damaged at most: if more seem to be, odometry is wrong as a whole, as in its unit."""
ACCELERATION = 10.0
"""m/s² that tyres can transmit to the floor."""
TURN_ACCELERATION = 20.0
"""rad/s², the same for a robot that turns on the spot, whose wheels are half a metre apart."""


def without_spikes(messages: Iterable[Message], anomalies: AnomalyCounter) -> Iterator[Message]:
    """Yield messages, ordered by time, without such readings.

    From a reading that may be one on, messages are held until the next reading of odometry.
    """
    before: Odometry | None = None
    held: list[Message] = []  # from a suspicious reading on
    readings = spikes = 0
    for message in messages:
        if not isinstance(message, Odometry):
            if held:
                held.append(message)
            else:
                yield message
            continue
        readings += 1
        if held:
            reading = held[0]
            assert before is not None
            assert isinstance(reading, Odometry)
            is_spike = _is_spike(before, reading, message)
            spikes += is_spike
            if is_spike and spikes - 1 <= MAX_SHARE * readings:
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
    return max(_distance(before, reading), abs(_turn(before, reading))) > TOLERANCE


def _is_spike(before: Odometry, reading: Odometry, after: Odometry) -> bool:
    """Return True if a robot cannot drive or turn to a reading and back between the readings before and after it.

    Half of the detour over the reading is compared with a/2 t^2, where t^2 is the product of both intervals. The turn
    without the detour is the sum of both turns: a robot that seems to turn on and on, as its headings have another
    unit, does not turn back.
    """
    detour = _distance(before, reading) + _distance(reading, after) - _distance(before, after)
    there, back = _turn(before, reading), _turn(reading, after)
    turned_back = abs(there) + abs(back) - abs(there + back)
    squared_time = (reading.stamp - before.stamp) * (after.stamp - reading.stamp)
    too_far = 0.5 * detour > max(TOLERANCE, 0.5 * ACCELERATION * squared_time)
    return too_far or 0.5 * turned_back > max(TOLERANCE, 0.5 * TURN_ACCELERATION * squared_time)


def _distance(first: Odometry, second: Odometry) -> float:
    """Return the distance between the positions of two readings, metres."""
    x, y, _ = (second.pose - first.pose).tolist()
    return math.hypot(x, y)


def _turn(first: Odometry, second: Odometry) -> float:
    """Return the turn from one reading to another, in [-pi, pi]."""
    return math.remainder(float(second.pose[2] - first.pose[2]), 2.0 * math.pi)
