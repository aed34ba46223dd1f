"""The nearest of several poses."""

from __future__ import annotations

import numpy as np

from drivers import se2

from .segments import Floats


def relative_to_nearest(poses: Floats, pose: se2.Pose) -> tuple[int, se2.Pose]:
    """Return the row of the nearest of some `poses` (n, 3) to a pose, and this pose in the frame of the nearest."""
    nearest = int(np.hypot(*(poses[:, :2] - pose[:2]).T).argmin())
    return nearest, se2.between(poses[nearest], pose)
