"""Events of tracking: poses of scans, and changes of the localisation."""

from __future__ import annotations

from dataclasses import field
from typing import TYPE_CHECKING

import numpy as np

from drivers.immutable import immutable
from drivers.se2 import Pose

from ..geometry.segments import Floats

if TYPE_CHECKING:
    from ..odometry.error_model import OdometryModel
    from ..odometry.velocity import VelocityFilter


@immutable
class ScanTracked:
    """A scan was tracked.

    pose           (3,) of the base in the map
    odometry       (3,) odometry pose at the same time
    overlap_ratio  share of the scan's wall length on known walls, 0 to 1
    keyframe       index of the last keyframe
    points         (p, 2) valid returns in the base's frame, metres
    covariance     (3, 3) of the pose in the map as it stands, in the base's frame; zero: unknown
    odometry_model copy of the error model of odometry as learned so far; None if it is unknown
    velocity       of the base in its own frame while odometry is failing, by which the motion is predicted; else None
    """

    stamp: float
    pose: Pose
    odometry: Pose
    overlap_ratio: float
    keyframe: int
    points: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    covariance: Floats = field(default_factory=lambda: np.zeros((3, 3)))
    odometry_model: OdometryModel | None = None
    velocity: VelocityFilter | None = None


@immutable
class GroundTruthReceived:
    """The recording contains the true pose, in the frame of the world."""

    stamp: float
    pose: Pose


@immutable
class StateChanged:
    """The localisation status changed to OK, DEGENERATE or LOST.

    If DEGENERATE, `direction` (radians in the map, 0 to pi) is the one in which only odometry determines the position.
    """

    stamp: float
    state: str
    direction: float | None


@immutable
class ModeChanged:
    """The map is only localised in from now on (`frozen`), or is extended."""

    stamp: float
    frozen: bool


@immutable
class Relocalised:
    """A lost or kidnapped robot was recognised in the map; the base is at `pose` (3,).

    The keyframes from `first` on, which it has mapped since then, are in their places in the map now.
    """

    stamp: float
    pose: Pose
    first: int
