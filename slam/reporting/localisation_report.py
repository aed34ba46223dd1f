"""Localisation status of a run: followed from scan to scan, published and recorded when it changes."""

from __future__ import annotations

from ..estimation.estimator import Estimator, ScanResult
from ..events import Notice, Relocalised
from ..localisation.state import LocalisationEvent, LocalisationState, LocalisationStateMachine
from .publisher import Publisher
from .run_statistics import RunStatistics


class LocalisationReport:
    """Localisation status of a run, with what publishes and records its changes."""

    def __init__(self, unobserved_sigma: float, publisher: Publisher, statistics: RunStatistics) -> None:
        """Start as localised; for `unobserved_sigma` see `LocalisationStateMachine`."""
        self._machine = LocalisationStateMachine(unobserved_sigma)
        self._publisher, self._statistics = publisher, statistics

    @property
    def state(self) -> LocalisationState:
        """Present localisation status."""
        return self._machine.state

    @property
    def lost(self) -> bool:
        """True if the pose is lost."""
        return self._machine.lost

    def update(self, stamp: float, result: ScanResult, estimator: Estimator) -> None:
        """Update the status by a scan: lost, recognised, placed by odometry, in the largest part, or tracked.

        A user who continues a map means that one, however small it is: the robot is LOST until it is recognised there.


        stamp      of the scan, seconds
        result     effects of the scan
        estimator  after the scan
        """
        if result.began_part:
            self._publisher.publish(Notice(stamp, "the pose is lost: a new part of the map begins here"))
            self._publisher.publish_map(stamp, estimator.result.mapper)
            self.handle(stamp, LocalisationEvent.TRACKING_LOST)
        elif result.joined is not None:
            self._publisher.publish(Relocalised(stamp, estimator.result.pose.copy(), result.joined))
            self._publisher.publish(Notice(stamp, "relocalised in the map", "INFO"))
            self.handle(stamp, LocalisationEvent.RELOCALISED)
        elif result.resumed:
            self._publisher.publish_map(stamp, estimator.result.mapper)
            self._publisher.publish(Notice(stamp, "the scans fit where the robot was expected in the map", "INFO"))
            self.handle(stamp, LocalisationEvent.RELOCALISED)
        elif result.retracted is not None and result.retracted.joins:
            self.handle(stamp, LocalisationEvent.TRACKING_LOST)
        elif not self.lost:
            self._publish(stamp, self._machine.update(result.tracking))
        elif estimator.placed_by_odometry:
            text = "the place is not in the map near the pose from odometry; it is mapped as a new place"
            self._publisher.publish(Notice(stamp, text, "INFO"))
            self.handle(stamp, LocalisationEvent.PLACED_BY_ODOMETRY)
        elif estimator.in_largest_part and not self._statistics.started_anywhere:
            text = "more is mapped since the pose was lost than before; this part of the map is the reference now"
            self._publisher.publish(Notice(stamp, text, "INFO"))
            self.handle(stamp, LocalisationEvent.PART_IS_LARGEST)

    def handle(self, stamp: float, event: LocalisationEvent) -> None:
        """Change the status by an event."""
        self._statistics.started_anywhere |= event is LocalisationEvent.STARTED_ANYWHERE
        self._publish(stamp, self._machine.handle(event))

    def _publish(self, stamp: float, state: LocalisationState | None) -> None:
        """Publish a localisation state if it has changed."""
        if state is not None:
            self._statistics.states.append((stamp, state))
            self._publisher.publish_state(stamp, state)
