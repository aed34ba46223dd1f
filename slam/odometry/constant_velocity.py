"""Motion of a robot without odometry: predicted at constant velocity, corrected by the poses of its scans."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drivers import se2
from drivers.messages import Odometry, Scan

from ..geometry.segments import Floats
from .gyroscope import Gyroscope
from .measurement_clock import MeasurementClock
from .velocity import VelocityFilter


class ConstantVelocity:
    """Odometry predicted at the velocity that was estimated from the poses of the scans."""

    def __init__(self, gyroscope: Gyroscope | None = None) -> None:
        """The turns are those of a `gyroscope` while it measures."""
        self._gyroscope = gyroscope or Gyroscope()
        self._filter, self._clock = VelocityFilter(), MeasurementClock()
        self._pose = np.zeros(3)  # of odometry at the last scan
        self._interval = 0.0  # seconds between the last two scans

    @property
    def velocity(self) -> Floats:
        """(3,) velocity [x, y, heading] in the base's frame, metres and radians per second."""
        return self._filter.velocity

    def readings(self, scan: Scan) -> Iterator[Odometry]:
        """Yield the predicted poses at the begin, the middle and the end of a scan's sweep, as odometry."""
        half = 0.5 * scan.duration
        middle, last = scan.stamp + half, self._clock.last
        self._interval = self._clock.interval(middle)
        turn = None if last is None else self._gyroscope.turn(last, middle)
        if turn is not None and self._interval > 0.0:
            self._filter.velocity = np.array([*self.velocity[:2], turn / self._interval])
        self._pose = self._moved(self._interval)
        if half > 0.0:
            yield Odometry(scan.stamp, self._moved(-half))
        yield Odometry(middle, self._pose)
        if half > 0.0:
            yield Odometry(scan.stamp + scan.duration, self._moved(half))

    def correct(self, motion: se2.Pose | None, covariance: Floats) -> None:
        """Correct the velocity by the motion between the last two scans; None if it is not known.

        `covariance` (3, 3) is that of the pose of a scan.
        """
        if self._interval > 0.0:
            self._filter.correct(motion, covariance, self._interval)

    def _moved(self, seconds: float) -> se2.Pose:
        """Return the pose some seconds after that of the last scan."""
        return se2.compose(self._pose, self._filter.motion(seconds))
