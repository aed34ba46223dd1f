"""Localisation status: how well the robot's pose in the map is known, as one state machine."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum, auto

from ..geometry.degeneracy import weakest_direction
from ..odometry.error_model import UNOBSERVED_SIGMA
from .tracking import TrackingResult, TrackingStatus

# Scans in a row that must agree before the status changes between OK and DEGENERATE.
# Origin: chosen, to suppress single scans; not measured.
CONFIRMING_SCANS = 3


class LocalisationStatus(StrEnum):
    """How well the robot's pose in the map is known."""

    OK = "OK"
    DEGENERATE = "DEGENERATE"  # in one direction by odometry alone, e.g. along a bare corridor
    LOST = "LOST"  # the pose in the map is unknown; a new part of the map has begun


class LocalisationEvent(Enum):
    """Events that change the localisation status."""

    OBSERVABLE = auto()  # scans determine the position in every direction
    UNOBSERVABLE = auto()  # scans leave one direction open
    TRACKING_LOST = auto()  # too many scans in a row fitted nowhere
    STARTED_ANYWHERE = auto()  # a session continues from an unknown pose
    RELOCALISED = auto()  # the place was recognised in the map
    PLACED_BY_ODOMETRY = auto()  # the place was not recognised, odometry connects it to the map
    PART_IS_LARGEST = auto()  # more was mapped since the pose was lost than in any part before: this is the map now


_STATUS, _EVENT = LocalisationStatus, LocalisationEvent
TRANSITIONS = {
    (_STATUS.OK, _EVENT.OBSERVABLE): _STATUS.OK,
    (_STATUS.OK, _EVENT.UNOBSERVABLE): _STATUS.DEGENERATE,
    (_STATUS.OK, _EVENT.TRACKING_LOST): _STATUS.LOST,
    (_STATUS.OK, _EVENT.STARTED_ANYWHERE): _STATUS.LOST,
    (_STATUS.OK, _EVENT.RELOCALISED): _STATUS.OK,  # kidnapped to a look-alike place, noticed while tracking
    (_STATUS.DEGENERATE, _EVENT.OBSERVABLE): _STATUS.OK,
    (_STATUS.DEGENERATE, _EVENT.UNOBSERVABLE): _STATUS.DEGENERATE,
    (_STATUS.DEGENERATE, _EVENT.TRACKING_LOST): _STATUS.LOST,
    (_STATUS.DEGENERATE, _EVENT.STARTED_ANYWHERE): _STATUS.LOST,
    (_STATUS.DEGENERATE, _EVENT.RELOCALISED): _STATUS.OK,
    (_STATUS.LOST, _EVENT.STARTED_ANYWHERE): _STATUS.LOST,
    (_STATUS.LOST, _EVENT.TRACKING_LOST): _STATUS.LOST,
    (_STATUS.LOST, _EVENT.RELOCALISED): _STATUS.OK,
    (_STATUS.LOST, _EVENT.PLACED_BY_ODOMETRY): _STATUS.OK,
    (_STATUS.LOST, _EVENT.PART_IS_LARGEST): _STATUS.OK,
}
"""New status by status and event. Pairs that are missing cannot occur."""


@dataclass(frozen=True, slots=True)
class LocalisationState:
    """Localisation status, and the degenerate direction in the map (radians, 0 to pi) if it is DEGENERATE."""

    status: LocalisationStatus
    direction: float | None = None


class LocalisationStateMachine:
    """Current localisation state, changed by events and by the tracking results of scans."""

    def __init__(self, unobserved_sigma: float = UNOBSERVED_SIGMA) -> None:
        """`unobserved_sigma` (metres): standard deviation above which scans do not determine the position."""
        self._unobserved_sigma = unobserved_sigma
        self.state = LocalisationState(LocalisationStatus.OK)
        self._contradicting_scans = 0  # in a row

    @property
    def lost(self) -> bool:
        """True while the pose is unknown."""
        return self.state.status is LocalisationStatus.LOST

    def handle(self, event: LocalisationEvent, direction: float | None = None) -> LocalisationState | None:
        """Apply an event; return the new state, or None if it is the same as before.

        `direction` is the degenerate direction of an UNOBSERVABLE event.
        """
        before = self.state
        self.state = LocalisationState(TRANSITIONS[before.status, event], direction)
        self._contradicting_scans = 0
        return None if self.state == before else self.state

    def update(self, tracking: TrackingResult) -> LocalisationState | None:
        """Apply a scan's tracking result; return the new state, or None if it is the same as before."""
        if tracking.status is not TrackingStatus.TRACKED:
            return None
        direction = weakest_direction(tracking.pose, tracking.registration.total_information, self._unobserved_sigma)
        event = LocalisationEvent.OBSERVABLE if direction is None else LocalisationEvent.UNOBSERVABLE
        changes = TRANSITIONS[self.state.status, event] is not self.state.status
        self._contradicting_scans = self._contradicting_scans + 1 if changes else 0
        return self.handle(event, direction) if self._contradicting_scans >= CONFIRMING_SCANS else None
