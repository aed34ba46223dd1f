"""Observations of walls, restored from the two factors of each."""

from __future__ import annotations

from collections.abc import Container, Mapping

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ..geometry.segments import Floats
from .factors import OBSERVATION_KINDS, Factor


@immutable
class WallSegment:
    """A segment of a wall, observed by a keyframe.

    keyframe    index
    wall        landmark id of the wall's variable
    frame       (3,) of the segment in the keyframe's frame
    covariance  (2, 2) of offset and heading at that frame
    bias_slope  (2,) offset and heading per metre of range bias
    index       0 for the first segment of the wall in the keyframe, 1 for the second, ...
    numbers     numbers of its two factors
    """

    keyframe: int
    wall: int
    frame: se2.Pose
    covariance: Floats
    bias_slope: Floats
    index: int
    numbers: tuple[int, int]


def wall_segments(factors: Mapping[int, Factor], walls: Container[int]) -> list[WallSegment]:
    """Return the observed segments of some walls, given the factors by their numbers.

    Inverts `FactorGraph.add_wall_observation`, which adds the factor of the offset right after that of the heading.
    """
    numbers = [
        number
        for number in sorted(factors)
        if factors[number].kind in OBSERVATION_KINDS and factors[number].second in walls
    ]
    count: dict[tuple[int, int], int] = {}
    segments = []
    for first, second in zip(numbers[::2], numbers[1::2], strict=True):
        heading, offset = factors[first], factors[second]
        ends = (heading.first, heading.second)
        along = float(se2.between(offset.measured[:3], heading.measured)[0])
        slope = along - offset.measured[3]  # of the expected error of the offset on that of the heading
        variance = float(heading.covariance[0, 0])
        across = float(offset.covariance[0, 0]) + slope**2 * variance
        covariance = np.array([[across, slope * variance], [slope * variance, variance]])
        turn = heading.bias_slope[0]
        bias_slope = np.array([offset.bias_slope[0] + slope * turn, turn])
        index = count[ends] = count.get(ends, -1) + 1
        segments.append(WallSegment(*ends, heading.measured, covariance, bias_slope, index, (first, second)))
    return segments
