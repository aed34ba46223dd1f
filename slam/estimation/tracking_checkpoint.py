"""Tracking state that a session stores, with the reference of the next motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers import se2

from ..geometry.segments import Floats
from ..localisation.local_field import LocalFieldState
from ..localisation.tracking import TrackerState


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """Reference of the next motion: a pose on the trajectory, stored relative to a keyframe.

    relative    (3,) [x, y, heading] in the keyframe's frame
    covariance  (3, 3) of `relative`, in its own frame
    odometry    (3,) odometry pose at the anchor
    """

    keyframe: int
    relative: se2.Pose
    covariance: Floats
    odometry: se2.Pose


@dataclass(frozen=True, slots=True, eq=False)
class TrackingCheckpoint:
    """Tracking state that a session stores.

    tracker              state of the tracker; None before the first scan
    field                state of the local field
    anchor               reference of the next motion; None before the first keyframe
    kidnapped            True if the robot was moved since the anchor without odometry noticing
    kidnapped_keyframes  keyframes reached in this way
    learned_until        end of the last motion that was learned from, if it is not the anchor
    """

    tracker: TrackerState | None
    field: LocalFieldState
    anchor: Anchor | None
    kidnapped: bool
    kidnapped_keyframes: Sequence[int]
    learned_until: Anchor | None = None
