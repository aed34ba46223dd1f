"""Velocity of a rolling platform, estimated from the poses of its scans."""

from __future__ import annotations

import numpy as np

from drivers import se2
from drivers.compiled import compiled

from ..geometry.segments import Floats
from .arc import with_turn

# Metres per second squared, twice, and radians per second squared: standard deviations of the acceleration of a rolling
# platform, which is as large to the side as ahead if the lidar is not on the axle.
# Origin: chosen, indoor robots accelerate by up to 1 m/s^2 and start to turn within half a second; not measured.
ACCELERATIONS = np.array([1.0, 1.0, 3.0])
# Velocities that no indoor robot exceeds, as standard deviations: the uncertainty does not grow beyond them.
# Origin: chosen, metres and radians per second.
MAX_VELOCITIES = np.array([1.0, 1.0, 2.0])
MAX_VARIANCES = MAX_VELOCITIES**2  # Origin: definition.
# Seconds for which a robot moves evenly: after that time it may have any velocity.
# Origin: definition, the time in which ACCELERATIONS lead to MAX_VELOCITIES.
STEADY_SECONDS = float((MAX_VELOCITIES / ACCELERATIONS).min())


class VelocityFilter:
    """Velocity [x, y, heading] in the base's frame, a Kalman filter for each component.

    Process noise is the acceleration of the platform, and a measurement the motion between two scans divided by their
    interval. Where the scans do not determine the motion, its variance is large, so that the velocity stays as it was.

    velocity   (3,) metres and radians per second
    variances  (3,)
    """

    def __init__(self, velocity: Floats | None = None, variances: Floats | None = None) -> None:
        self.velocity = np.zeros(3) if velocity is None else velocity
        self.variances = MAX_VARIANCES if variances is None else variances

    def copy(self) -> VelocityFilter:
        """Return a copy that corrections do not change; it shares the arrays, which are replaced and never changed."""
        return VelocityFilter(self.velocity, self.variances)

    def motion(self, seconds: float) -> se2.Pose:
        """Return the motion [x, y, heading] within some seconds, along an arc."""
        arc = self.velocity * seconds
        turn, arc[2] = float(arc[2]), 0.0
        return with_turn(arc, turn)

    def deviations(self, seconds: float) -> Floats:
        """Return (3,) the standard deviations of a motion within some seconds, metres and radians."""
        return np.asarray(_deviations(self.variances, seconds))

    def correct(self, motion: se2.Pose | None, covariance: Floats, seconds: float) -> None:
        """Correct the velocity by the motion within some seconds; None if it is not known.

        `covariance` (3, 3) is that of the pose at its end.
        """
        self.variances = _predicted_variances(self.variances, seconds)
        if motion is not None:
            arc = with_turn(motion, 0.0)
            arc[2] = motion[2]
            self.velocity, self.variances = _corrected(
                self.velocity, self.variances, arc, covariance, seconds, seconds**2
            )


@compiled
def _predicted_variances(variances, seconds):  # type: ignore[no-untyped-def]
    """Return the variances (3,) of a velocity some seconds later."""
    predicted = np.empty(3)
    for k in range(3):
        gained = ACCELERATIONS[k] * seconds
        predicted[k] = min(variances[k] + gained * gained, MAX_VARIANCES[k])
    return predicted


@compiled
def _deviations(variances, seconds):  # type: ignore[no-untyped-def]
    """Return (3,) the standard deviations of a motion within some seconds."""
    return np.sqrt(_predicted_variances(variances, seconds)) * seconds


@compiled
def _corrected(velocity, variances, arc, covariance, seconds, squared):  # type: ignore[no-untyped-def]
    """Return the velocity (3,) and its variances (3,), corrected by an arc (3,) driven within some seconds.

    covariance  (3, 3) of the poses at both ends of the arc
    squared     seconds squared
    """
    new_velocity, new_variances = np.empty(3), np.empty(3)
    for k in range(3):
        gain = variances[k] / (variances[k] + 2.0 * covariance[k, k] / squared)
        new_velocity[k] = velocity[k] + gain * (arc[k] / seconds - velocity[k])
        new_variances[k] = (1.0 - gain) * variances[k]
    return new_velocity, new_variances
