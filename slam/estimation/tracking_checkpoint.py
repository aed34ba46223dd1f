"""State of tracking that a session stores, so that a continued run goes on from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from drivers import se2
from drivers.immutable import immutable
from drivers.messages import Odometry

from ..geometry.segments import Floats
from ..localisation.local_field import LocalFieldState
from ..localisation.tracking import TrackerState


@immutable
class Anchor:
    """Pose on the trajectory from which the motion to the next keyframe is measured.

    It is stored relative to a keyframe, since that may be moved before the next one comes.

    keyframe    index of the keyframe
    relative    (3,) [x, y, heading] in the keyframe's frame, metres and radians
    covariance  (3, 3) of `relative`, in its own frame
    odometry    reading of odometry at the same time
    """

    keyframe: int
    relative: se2.Pose
    covariance: Floats
    odometry: Odometry

    def shifted(self, seconds: float) -> Anchor:
        """Return the anchor with some seconds added to its stamp."""
        return replace(self, odometry=replace(self.odometry, stamp=self.odometry.stamp + seconds))


@immutable
class TrackingCheckpoint:
    """State of tracking that a session stores.

    tracker              state of the tracker; None before the first scan
    field                state of the local field
    anchor               start of the motion to the next keyframe; None before the first keyframe
    kidnapped            True if the robot was moved since the anchor without odometry noticing
    kidnapped_keyframes  indices of the keyframes before which it was moved in this way
    learned_until        end of the last motion that odometry's errors were learned from; None if that is the anchor
    """

    tracker: TrackerState | None
    field: LocalFieldState
    anchor: Anchor | None
    kidnapped: bool
    kidnapped_keyframes: Sequence[int]
    learned_until: Anchor | None = None

    def shifted(self, seconds: float) -> TrackingCheckpoint:
        """Return the state with some seconds added to its stamps."""
        tracker = None if self.tracker is None else self.tracker.shifted(seconds)
        anchor, until = (one and one.shifted(seconds) for one in (self.anchor, self.learned_until))
        return replace(self, tracker=tracker, anchor=anchor, learned_until=until)
