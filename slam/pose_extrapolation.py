"""Pose of the base now: that of the last scan, extrapolated by odometry, or by an even motion if odometry is failing.

It is output only, and never enters the estimate.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from threading import Lock
from typing import ClassVar

import numpy as np

from drivers import se2
from drivers.immutable import immutable
from drivers.messages import Odometry

from .events import Event, KeyframeAdded, ScanTracked, StateChanged
from .geometry.pose_covariance import covariance_after
from .geometry.segments import Floats
from .localisation.state import LocalisationStatus
from .odometry.error_model import OdometryModel
from .odometry.history import QUARTER_TURN
from .odometry.velocity import STEADY_SECONDS, VelocityFilter

# Odometry readings that are kept until a scan measured at their time was processed. Origin: chosen, half a minute of a
# fast base, longer than any scan takes.
KEPT_READINGS = 2000
# Seconds by which a scan may be processed before the next reading is known here. Stamps that are farther ahead are on
# another clock, as in a continued session. Origin: chosen, many periods of a base; not measured.
MAX_WAIT = 0.5


@immutable
class ExtrapolatedPose:
    """Pose of the base in the map at the stamp of an odometry reading.

    stamp       seconds
    pose        (3,) [x, y, heading]
    covariance  (3, 3) in the pose's own frame
    odometry    (3,) odometry pose at the same time
    status      localisation status
    """

    stamp: float
    pose: se2.Pose
    covariance: Floats
    odometry: se2.Pose
    status: LocalisationStatus

    @property
    def odometry_in_map(self) -> se2.Pose:
        """Pose of the odometry's frame in the map."""
        return se2.compose(self.pose, se2.inverse(self.odometry))


@immutable
class _Fix:
    """Pose of the base in the map at the last scan.

    stamp     seconds, on the clock of odometry
    odometry  (3,) odometry pose at this time
    model     of odometry's errors; None if it is unknown
    velocity  of the base while odometry is failing, else None
    """

    stamp: float
    pose: se2.Pose
    odometry: se2.Pose
    covariance: Floats
    model: OdometryModel | None
    velocity: VelocityFilter | None

    def motion_until(self, reading: Odometry) -> tuple[se2.Pose, Floats]:
        """Return the motion since then and its covariance (3, 3)."""
        if self.velocity is not None:
            seconds = min(max(reading.stamp - self.stamp, 0.0), STEADY_SECONDS)
            return self.velocity.motion(seconds), np.diag(self.velocity.deviations(seconds) ** 2)
        motion = se2.between(self.odometry, reading.pose)
        if self.model is None or np.array_equal(self.odometry, reading.pose):  # standing wheels do not err
            return motion, np.zeros((3, 3))
        motion = self.model.correct(motion)
        return motion, self.model.covariance(motion)


class PoseExtrapolator:
    """Sink that keeps the last pose, and extrapolates it by odometry that has not been processed yet.

    With T the motion since the last scan, as odometry measured it and corrected for the systematic errors that were
    learned, the pose is the scan's followed by T, and its covariance is

        Ad(T)^-1 P Ad(T)^-T + Q,

    where P is the covariance of the scan's pose, whose errors are those of the last keyframe, and Q that of the motion
    by the error model. On a map that does not change, P is the covariance of the pose in it. While odometry is failing,
    T and Q are those of a robot that moves on as it did, and stops after STEADY_SECONDS without a scan. `at` may be
    called from any thread.

    delay  seconds by which the lidar's stamps are late against odometry's
    """

    handled: ClassVar[tuple[type[Event], ...]] = (ScanTracked, KeyframeAdded, StateChanged)

    def __init__(self, delay: float = 0.0) -> None:
        self.delay = delay
        self._lock = Lock()
        self._readings: deque[Odometry] = deque(maxlen=KEPT_READINGS)
        self._status = LocalisationStatus.OK
        self._keyframe: KeyframeAdded | None = None
        self._fix: _Fix | None = None  # replaced as a whole, for the other threads
        self._passed: tuple[_Fix, _Fix] | None = None  # a fix, and where odometry has led to since then; see `at`

    def handle(self, event: Event) -> None:
        """Process one event."""
        match event:
            case ScanTracked():
                covariance = event.covariance if self._keyframe is None else _moved(self._keyframe, event.pose)
                stamp = event.stamp - self.delay
                odometry = self._measured_at(stamp, event.odometry)
                self._fix = _Fix(stamp, event.pose, odometry, covariance, event.odometry_model, event.velocity)
            case KeyframeAdded():  # the same scan, after the map has changed
                self._keyframe = event
                if self._fix is not None:
                    self._fix = replace(self._fix, pose=event.pose, covariance=event.pose_covariance)
            case StateChanged():
                self._status = LocalisationStatus(event.state)

    def at(self, reading: Odometry) -> ExtrapolatedPose | None:
        """Return the pose at an odometry reading, the next one; None before the first scan.

        While no scan is processed, the motion is divided after each quarter turn: its systematic errors depend on the
        turn, which two poses of odometry tell up to full turns only.
        """
        with self._lock:
            self._readings.append(reading)
        fix = self._fix
        if fix is None:
            return None
        passed = self._passed
        start = fix if passed is None or passed[0] is not fix else passed[1]
        motion, own = start.motion_until(reading)
        pose, covariance = se2.compose(start.pose, motion), covariance_after(start.covariance, motion) + own
        if fix.velocity is None and abs(se2.between(start.odometry, reading.pose)[2]) > QUARTER_TURN:
            self._passed = fix, replace(start, pose=pose, odometry=reading.pose, covariance=covariance)
        return ExtrapolatedPose(reading.stamp, pose, covariance, reading.pose, self._status)

    def at_scan(self, stamp: float) -> ExtrapolatedPose | None:
        """Return the pose of the last scan, of this stamp; None before the first one."""
        fix = self._fix
        if fix is None:
            return None
        return ExtrapolatedPose(stamp, fix.pose, fix.covariance, fix.odometry, self._status)

    def _measured_at(self, stamp: float, processed: se2.Pose) -> se2.Pose:
        """Return the odometry pose at a stamp, interpolated between readings.

        It is not that of the scan, `processed`, if a gyroscope has improved odometry; that is the best guess if there
        are no readings of this time.
        """
        after: Odometry | None = None
        with self._lock:
            for reading in reversed(self._readings):
                if reading.stamp <= stamp:
                    break
                after = reading
            else:
                return processed
        if after is None:
            return reading.pose if stamp - reading.stamp < MAX_WAIT else processed
        part = (stamp - reading.stamp) / (after.stamp - reading.stamp)
        return se2.compose(reading.pose, part * se2.between(reading.pose, after.pose))


def _moved(keyframe: KeyframeAdded, pose: se2.Pose) -> Floats:
    """Return the covariance (3, 3) of a pose near a keyframe, whose errors it shares."""
    return covariance_after(keyframe.pose_covariance, se2.between(keyframe.pose, pose))
