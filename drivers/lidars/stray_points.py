"""Stray points of LDROBOT's LD06 and LD19: weak returns of edges, dust and sunlight, in which nothing is.

The limits are those of the filter in the manufacturer's SDK for these lidars (ldlidar_stl_sdk, "near filter").
"""

from __future__ import annotations

import numpy as np

from .measurements import Flags, StructuredArray

NEAR = 5.0
"""Metres; farther points are never strays."""
SAME_SURFACE = 0.03
"""Relative difference of the ranges of neighbours on one surface."""
FEW, SMALL = 3, 15
"""Points of a group: fewer than FEW are strays unless they are strong, up to SMALL if they are weak."""
STRONG, WEAK = 220, 15
"""Mean intensity of a group, of 255."""


def find_stray_points(samples: StructuredArray) -> Flags:
    """Return which samples (n,) of SAMPLE of one revolution, in the order measured, are strays.

    Neighbours on one surface form a group; the last sample is a neighbour of the first.
    """
    ranges, count = samples["range"], len(samples)
    near = ranges < NEAR  # False for NaN
    if not near.any():
        return near
    previous = np.roll(ranges, 1)
    joined = near & np.roll(near, 1) & (np.abs(ranges - previous) <= SAME_SURFACE * previous)
    first = int(np.argmin(joined))  # begin where a group begins, so that none is divided; a full circle has one group
    groups = np.roll(np.cumsum(~np.roll(joined, -first)), first)
    sizes = np.bincount(groups, near, minlength=count + 1)
    means = np.bincount(groups, np.where(near, samples["quality"], 0), minlength=count + 1) / np.maximum(sizes, 1)
    stray = ((sizes < FEW) & (means < STRONG)) | ((sizes <= SMALL) & (means <= WEAK))
    return np.asarray(near & stray[groups])
