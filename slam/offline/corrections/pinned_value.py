"""Surveyed coordinates of a pose, or of a point on a wall, compared with the map."""

from __future__ import annotations

import math

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ...geometry.segments import Floats


@immutable
class PinnedValue:
    """A pin and what it states about the map.

    point       (2,) surveyed, in the frame of the survey, metres
    covariance  (2, 2) of it
    heading     surveyed, radians, with its standard deviation; None if it was not
    estimate    (3,) the pose, or the frame of the wall, in the map
    is_wall     True if the point is anywhere on a wall: then only its distance from the line is compared
    """

    point: Floats
    covariance: Floats
    heading: tuple[float, float] | None
    estimate: se2.Pose
    is_wall: bool

    @property
    def size(self) -> int:
        """Number of values."""
        return (1 if self.is_wall else 2) + (self.heading is not None)

    def differences(self, motion: se2.Pose) -> Floats:
        """Return the surveyed values minus those of the map, (size,) in metres and radians.

        `motion` takes the survey into the map.
        """
        x, y = se2.transform(motion, self.point) - self.estimate[:2]
        heading = float(self.estimate[2])
        values = [math.cos(heading) * y - math.sin(heading) * x] if self.is_wall else [x, y]
        if self.heading is not None:
            turn = float(se2.wrap(self.heading[0] + motion[2] - heading))
            half = math.remainder(turn, math.pi)  # a line has no direction
            values.append(half if self.is_wall else turn)
        return np.array(values)

    def jacobian(self, motion: se2.Pose, centre: Floats) -> Floats:
        """Return the Jacobian (size, 3) of the differences by a shift and a turn about `centre` of the moved survey."""
        x, y = se2.transform(motion, self.point) - centre
        result = np.array([[1.0, 0.0, -y], [0.0, 1.0, x]])
        if self.is_wall:
            result = self._normal[None] @ result
        return result if self.heading is None else np.vstack([result, [0.0, 0.0, 1.0]])

    def noise(self, motion: se2.Pose) -> Floats:
        """Return the covariance (size, size) of the survey, in the axes of the map."""
        c, s = math.cos(motion[2]), math.sin(motion[2])
        turn = np.array([[c, -s], [s, c]])
        moved = turn @ self.covariance @ turn.T
        if self.is_wall:
            moved = np.array([[self._normal @ moved @ self._normal]])
        result = np.zeros((self.size, self.size))
        result[: len(moved), : len(moved)] = moved
        if self.heading is not None:
            result[-1, -1] = self.heading[1] ** 2
        return result

    def along(self, motion: se2.Pose) -> float:
        """Return where along the wall, from its frame, the surveyed point is, metres."""
        x, y = se2.transform(motion, self.point) - self.estimate[:2]
        return float(math.cos(self.estimate[2]) * x + math.sin(self.estimate[2]) * y)

    @property
    def _normal(self) -> Floats:
        return np.array([-math.sin(self.estimate[2]), math.cos(self.estimate[2])])
