"""The part of the map around the robot that the next scans are compared with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .segments import Floats

Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class LocalMap:
    """n walls and m corners near a keyframe.

    walls            (n,) identities
    frame            (n, 3) in the map: x along the wall, which is seen from y > 0
    low, high        (n,) metres along x, how far the wall is known
    wall_covariance  (n, 2, 2) of the offset across and the heading at the frame, as seen from the keyframe
    corners          (m,) identities
    position         (m, 2) in the map
    headings         (m, 2) of the walls before and after the corner, in the map
    corner_covariance (m, 2, 2) as seen from the keyframe, in the map's axes
    """

    walls: Integers
    frame: Floats
    low: Floats
    high: Floats
    wall_covariance: Floats
    corners: Integers
    position: Floats
    headings: Floats
    corner_covariance: Floats


def empty_local_map() -> LocalMap:
    """What is known before the first scan."""
    none = np.zeros(0, dtype=np.int64)
    return LocalMap(
        none, np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros((0, 2, 2)),
        none, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2, 2)),
    )  # fmt: skip
