"""Motion of a robot without odometry: predicted at constant velocity, corrected by the poses of its scans."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from drivers import se2
from drivers.messages import Odometry, Scan

from ..geometry.segments import Floats
from .gyroscope import Gyroscope

# Metres per second squared, twice, and radians per second squared: standard deviations of the acceleration of a rolling
# platform, which is as large to the side as ahead if the lidar is not on the axle.
# Origin: chosen, indoor robots accelerate by up to 1 m/s^2 and start to turn within half a second; not measured.
ACCELERATIONS = np.array([1.0, 1.0, 3.0])
# Velocities that no indoor robot exceeds, as standard deviations: the uncertainty does not grow beyond them.
# Origin: chosen, metres and radians per second.
MAX_VELOCITIES = np.array([1.0, 1.0, 2.0])
# Latest intervals between scans of which the median is the lidar's period, or the mean if they come in bursts.
# Origin: chosen, some seconds; not measured.
PERIOD_SAMPLES = 21
# Share of the period below which the interval between two stamps shows that they come in bursts: no lidar is twice as
# fast at once. Origin: chosen. On the full Intel log, the median error of predictions is 3 mm instead of 23 mm.
MIN_INTERVAL = 0.5


class ConstantVelocity:
    """Velocity [x, y, heading] in the base's frame, a Kalman filter for each component.

    Process noise is the acceleration of the platform, and a measurement the motion between two scans divided by their
    interval. Where the scans do not determine the motion, its variance is large, so that the velocity stays as it was.

    The stamps of recordings may come in bursts, if a busy computer stamped the scans when it read them. The lidar
    turned evenly meanwhile, so the mean of the latest intervals is used then.
    """

    def __init__(self, gyroscope: Gyroscope | None = None) -> None:
        """The turns are those of a `gyroscope` while it measures."""
        self._gyroscope = gyroscope or Gyroscope()
        self.velocity = np.zeros(3)
        self._variances = MAX_VELOCITIES**2
        self._pose = np.zeros(3)  # of odometry at the last scan
        self._last: float | None = None  # stamp of the middle of the last scan
        self._intervals: list[float] = []
        self._interval = 0.0  # seconds between the last two scans

    def readings(self, scan: Scan) -> Iterator[Odometry]:
        """Yield the predicted poses at the begin, the middle and the end of a scan's sweep, as odometry."""
        half = 0.5 * scan.duration
        middle = scan.stamp + half
        last, self._last = self._last, middle
        self._interval = 0.0 if last is None else self._spacing(middle - last)
        turn = None if last is None else self._gyroscope.turn(last, middle)
        if turn is not None and self._interval > 0.0:
            self.velocity = np.array([*self.velocity[:2], turn / self._interval])
        self._pose = self._moved(self._pose, self._interval)
        if half > 0.0:
            yield Odometry(scan.stamp, self._moved(self._pose, -half))
        yield Odometry(middle, self._pose)
        if half > 0.0:
            yield Odometry(scan.stamp + scan.duration, self._moved(self._pose, half))

    def correct(self, motion: se2.Pose | None, covariance: Floats) -> None:
        """Correct the velocity by the motion between the last two scans; None if it is not known.

        `covariance` (3, 3) is that of the motion.
        """
        if self._interval <= 0.0:
            return
        predicted = self._variances + (ACCELERATIONS * self._interval) ** 2
        self._variances = np.minimum(predicted, MAX_VELOCITIES**2)
        if motion is not None:
            noise = 2.0 * np.diag(covariance) / self._interval**2  # of the poses at both ends
            gain = self._variances / (self._variances + noise)
            self.velocity = self.velocity + gain * (_turned(motion, -0.5) / self._interval - self.velocity)
            self._variances = (1.0 - gain) * self._variances

    def _spacing(self, interval: float) -> float:
        """Return the seconds between two scans, given those between their stamps."""
        self._intervals = [*self._intervals, interval][-PERIOD_SAMPLES:]
        period = float(np.median(self._intervals))
        in_bursts = min(self._intervals) < MIN_INTERVAL * period
        return float(np.mean(self._intervals)) if in_bursts else max(interval, period)

    def _moved(self, pose: se2.Pose, seconds: float) -> se2.Pose:
        """Return the pose after some seconds."""
        return se2.compose(pose, _turned(self.velocity * seconds, 0.5))


def _turned(motion: se2.Pose, share: float) -> se2.Pose:
    """Return a motion, its direction turned by a share of its own turn: the chord of an arc points half of it on."""
    c, s = math.cos(share * motion[2]), math.sin(share * motion[2])
    return np.array([c * motion[0] - s * motion[1], s * motion[0] + c * motion[1], motion[2]])
