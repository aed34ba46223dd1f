"""Where the motions between scans come from: wheels, wheels and a gyroscope, or prediction from the scans alone."""

from __future__ import annotations

from collections.abc import Iterator

from drivers import se2
from drivers.messages import Odometry, Scan, YawRate

from ..config import OdometryConfig
from ..geometry.segments import Floats
from .constant_velocity import ConstantVelocity
from .continuity import ContinuousOdometry
from .gyroscope import Gyroscope, GyroscopeOdometry


class MotionSource:
    """Odometry of a run, as measured or as predicted; the registered poses of the scans correct what it learns.

    predicted  True if there is no odometry, or if it is ignored
    """

    def __init__(self, config: OdometryConfig, earlier: Odometry | None = None) -> None:
        """`earlier` is the last reading of the run that is continued."""
        self.predicted = config.source == "none"
        self._use_gyroscope = config.gyroscope
        self._gyroscope = Gyroscope()
        self._readings = ContinuousOdometry(earlier)
        self._wheels = GyroscopeOdometry(self._gyroscope)
        self._prediction = ConstantVelocity(self._gyroscope)

    @property
    def learns(self) -> bool:
        """True if the motion from scan to scan corrects something: the gyroscope's bias or the predicted velocity."""
        return self.predicted or self._gyroscope.present

    @property
    def jump(self) -> str | None:
        """What the last reading of the wheels came after, as text, if that was a jump, which is left out."""
        return self._readings.jump

    def measurements(self, message: Odometry | Scan | YawRate) -> Iterator[Odometry | Scan]:
        """Yield the odometry and the scans to use when a message arrives."""
        if isinstance(message, YawRate):
            if self._use_gyroscope:
                self._gyroscope.add(message)
        elif isinstance(message, Scan):
            if self.predicted and not message.lidar:
                yield from self._prediction.readings(message)
            yield message
        elif not self.predicted:
            yield self._wheels.combined(self._readings.continued(message))

    def correct(self, stamp: float, motion: se2.Pose | None, covariance: Floats, turned: float = 0.0) -> None:
        """Learn from the motion of the base between the last two scans, the later of them at `stamp` seconds.

        motion      None if it is not known
        covariance  (3, 3) of the pose of a scan
        turned      radians by which the map then turned the pose of the later scan
        """
        self._gyroscope.correct(stamp, None if motion is None else float(motion[2]), float(covariance[2, 2]), turned)
        if self.predicted:
            self._prediction.correct(motion, covariance)

    def summary(self) -> dict[str, object]:
        """Return the estimated bias of the gyroscope (radians per second) as plain data; empty without a gyroscope."""
        if not self._gyroscope.present:
            return {}
        bias, sigma = round(self._gyroscope.bias, 6), round(self._gyroscope.sigma, 6)
        return {"gyroscope": {"bias": bias, "sigma": sigma}}
