"""Whether the robot knows where it is: in every direction, in all but one, or not at all."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from ..geometry.degeneracy import weakest_direction
from ..odometry.error_model import ADRIFT_SIGMA
from .tracker import TrackingResult, TrackingStatus

IN_A_ROW = 3  # scans that must say so before the state changes


class Condition(Enum):
    """How well the robot's place in the map is known."""

    OK = "OK"
    DEGENERATE = "DEGENERATE"  # along one direction, say of a bare corridor, by odometry alone
    LOST = "LOST"  # the robot is not where it was believed to be


@dataclass(frozen=True, slots=True)
class State:
    """A condition, and if it is DEGENERATE the direction in the map (radians, between 0 and pi) that is not known."""

    condition: Condition
    direction: float | None = None


class LocalisationMonitor:
    """Follows the placements of scans."""

    def __init__(self) -> None:
        self.state = State(Condition.OK)
        self._streak = 0  # scans in a row that say the other thing

    def lose(self) -> State:
        """The robot is lost until it is found."""
        self.state, self._streak = State(Condition.LOST), 0
        return self.state

    def find(self) -> State | None:
        """The robot knows where it is; the new state, if it did not before."""
        before, self.state, self._streak = self.state, State(Condition.OK), 0
        return None if before == self.state else self.state

    def update(self, tracking: TrackingResult) -> State | None:
        """Take a scan's placement; the new state, where it has changed."""
        if tracking.status is not TrackingStatus.TRACKED:
            return None
        direction = weakest_direction(tracking.pose, tracking.registration.held_by, ADRIFT_SIGMA)
        condition = Condition.OK if direction is None else Condition.DEGENERATE
        self._streak = 0 if condition is self.state.condition else self._streak + 1
        if self._streak < IN_A_ROW:
            return None
        self.state, self._streak = State(condition, direction), 0
        return self.state
