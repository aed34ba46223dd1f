"""Whether a robot went its way from one scan to the next, or was taken elsewhere in between.

A robot that is carried away sees something else at a stroke, while its wheels know of nothing. One that drives sees
much the same, moved as odometry has it, even where the map fits nothing of it: then the map is wrong there, or the way
to it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers import se2

from ..geometry.segments import Floats
from ..matching.likelihood_field import likelihood_scores, make_field
from ..odometry.history import wheel_travel

# Motions [x, y, heading] by which odometry may be wrong from one scan to the next.
SLIPS = np.stack(
    np.meshgrid([-0.1, 0.0, 0.1], [-0.1, 0.0, 0.1], np.radians(np.arange(-16.0, 16.1, 2.0)), indexing="ij"), axis=-1
).reshape(-1, 3)
# Likeness that two scans in a row reach, moved as odometry has it and a little more. On recordings 98.5 % and more of a
# driving robot's did, in simulation with worn wheels all; of scans from anywhere in a building 1 to 2 %, where places
# look alike 25 to 52 %.
ALIKE = 0.5
LEAST_POINTS = 30  # that both must have: few of them lie well nearly everywhere
OVERLAPPING = 1.0  # metres of driving after which much the same is still seen


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The points (p, 2) of a scan in the base's frame, and where odometry had that."""

    odometry: se2.Pose
    points: Floats

    @property
    def comparable(self) -> bool:
        """Whether it shows enough to be told from others."""
        return len(self.points) >= LEAST_POINTS

    def differs_from(self, other: View, motion: se2.Pose) -> bool:
        """Whether another view, after a `motion`, is of another place.

        If either shows next to nothing, or they are too far apart to overlap, nothing says so.
        """
        if not self.comparable or not other.comparable or wheel_travel(motion) > OVERLAPPING:
            return False
        field = make_field(self.points, np.zeros((0, 2)), np.zeros(3))
        return bool(likelihood_scores(field, other.points, se2.compose(motion, SLIPS)).max() < ALIKE)
