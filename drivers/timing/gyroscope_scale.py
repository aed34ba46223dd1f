"""Find rates of a gyroscope in degrees per second, and axes that point down, by the turns of the lidar.

Some drivers publish degrees per second, or axes as they are on the board.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cached_property

import numpy as np

from ..messages import Message, YawRate
from .turn_scale import TurnScale, estimate_turn_scale
from .turns import Turns

# Seconds between rates at most, to add them up. Origin: chosen, as for a gyroscope that is silent; not measured.
MAX_PERIOD = 0.2
# Scales of the units that are known, by their names. Origin: definition.
UNITS = {"radians per second": 1.0, "degrees per second": 180.0 / np.pi}


class GyroscopeScale:
    """How the rates of a gyroscope are read, given the scale of its turns."""

    def __init__(self, turns: TurnScale) -> None:
        self.turns = turns

    @cached_property
    def used(self) -> float | None:
        """Scale of the unit and direction that the rates are in; None if they do not measure the turns of the lidar.

        It is 1, radians per second counter-clockwise, unless that is certainly wrong.
        """
        return self.turns.decide([direction * unit for unit in UNITS.values() for direction in (1.0, -1.0)])

    def interpretations(self) -> list[str]:
        """Return how the rates are read if they are converted, as lines of text."""
        if self.used is None or self.used == 1.0:
            return []
        unit = next(name for name, scale in UNITS.items() if scale == abs(self.used))
        return [f"gyroscope in {unit}{' clockwise' * (self.used < 0.0)}, {self.turns}; converted"]

    def doubts(self) -> list[str]:
        """Return what is probably wrong with the rates, as lines of text."""
        if self.used is None:
            return [f"the gyroscope does not measure the turns of the lidar, {self.turns}: it is ignored"]
        if self.used < 0.0:
            return [
                "gyroscope and lidar turn in opposite directions, so one of them is upside down; if it is the lidar, "
                "the map is a mirror image"
            ]
        return []

    def converted(self, messages: Iterable[Message]) -> Iterator[Message]:
        """Yield messages with the rates in radians per second counter-clockwise, without those that are of no use."""
        for message in messages:
            if not isinstance(message, YawRate) or self.used == 1.0:
                yield message
            elif self.used is not None:
                yield YawRate(message.stamp, message.rate / self.used)


def estimate_gyroscope_scale(turns: Turns) -> GyroscopeScale | None:
    """Return the scale over the turns of a drive; None if the data do not determine it."""
    if len(turns.rates) < 2:
        return None
    stamps, rates = turns.rates.T
    angles = np.concatenate([[0.0], np.cumsum(0.5 * (rates[1:] + rates[:-1]) * np.diff(stamps))])
    found = estimate_turn_scale(turns.runs, stamps, angles, MAX_PERIOD)
    return None if found is None else GyroscopeScale(found)
