"""Right angles and parallels: hypotheses about the directions of walls, accepted if the joint covariance supports them.

A wall belongs to a group of walls that are parallel or perpendicular to each other if its direction agrees with that
of the group, and if a skew by MAX_SKEW or more is refuted (two one-sided tests, Schuirmann 1987; equations in
docs/measuring.md#right-angles-and-parallels). So a wall that is skewed by MAX_SKEW is hardly ever accepted, and one
whose direction is too uncertain to tell stays as it is. Accepted hypotheses, A x = b, are imposed on all walls x with
the covariance C by least squares,

    x' = x - C A' (A C A')^-1 (A x - b),   C' = C - C A' (A C A')^-1 A C,

one after the other, which gives the same result; later walls are tested with what earlier ones have determined.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from drivers.immutable import immutable

from ..geometry.segments import Floats
from ..mapping.map_features import MapCorners
from .measurement import are_parallel
from .wall_map import WallMap

MAX_SKEW = math.radians(1.0)
"""Skew that must be distinguishable from none."""
Z_EQUAL = 3.29
"""Standard deviations within which a correct hypothesis is accepted with a probability of 99.9 %."""
ERROR_RATE = 0.01
"""Probability that a wall which is skewed by MAX_SKEW is made regular, in the whole map."""
MIN_DEVIATION = 1e-9
"""Radians; directions that earlier hypotheses have made equal need none of their own."""


@immutable
class RegularMap:
    """A map with the hypotheses imposed that its covariance supports.

    wall_map  the map; its covariance is singular
    groups    rows of the walls that are parallel or perpendicular to each other, the largest group first
    alone     rows of the walls that belong to no group
    """

    wall_map: WallMap
    groups: list[list[int]]
    alone: list[int]

    @property
    def text(self) -> str:
        """How many walls were made regular, in words."""
        sizes = " + ".join(str(len(group)) for group in self.groups)
        return f"{sizes or 'no'} walls are parallel or at right angles, {len(self.alone)} are left as they are"


def regularise(wall_map: WallMap) -> RegularMap:
    """Return the map with right angles and parallels where the joint covariance of its walls supports them.

    A group begins with the wall whose heading is known best among those without a group. The other walls without a
    group are tested against it. When walls have joined, the rest is tested again, as the direction of the group is
    known better then.
    """
    hypotheses = _Hypotheses(wall_map)
    remaining: list[int] = np.argsort(np.diag(wall_map.covariance)[1::2], kind="stable").tolist()
    groups: list[list[int]] = []
    while remaining:
        groups.append([remaining.pop(0)])
        while joining := [row for row in remaining if hypotheses.accept(groups[-1][0], row)]:
            groups[-1] += joining
            remaining = [row for row in remaining if row not in joining]
    alone = sorted(group[0] for group in groups if len(group) == 1)
    joined = sorted((group for group in groups if len(group) > 1), key=len, reverse=True)
    return RegularMap(_changed(wall_map, hypotheses.change, hypotheses.covariance), joined, alone)


class _Hypotheses:
    """Accepted hypotheses: the changes (2 n,) of offset and heading of all walls, and their covariance from then on."""

    def __init__(self, wall_map: WallMap) -> None:
        self.heading = wall_map.walls.frame[:, 2]
        self.change, self.covariance = np.zeros(2 * len(self.heading)), wall_map.covariance.copy()
        self.z_skewed = -float(ndtri(ERROR_RATE / max(1, len(self.heading))))

    def accept(self, reference: int, row: int) -> bool:
        """Make the directions of two walls equal modulo 90 degrees if this is supported; return True if so."""
        difference, sigma = self.difference(reference, row)
        refuted = abs(difference) > max(Z_EQUAL * sigma, MIN_DEVIATION)
        if refuted or abs(difference) + self.z_skewed * sigma > MAX_SKEW:
            return False
        if sigma > MIN_DEVIATION:
            gain = (self.covariance[:, 2 * row + 1] - self.covariance[:, 2 * reference + 1]) / sigma**2
            self.change -= gain * difference
            self.covariance -= sigma**2 * np.outer(gain, gain)
        return True

    def difference(self, reference: int, row: int) -> tuple[float, float]:
        """Return the difference of two walls' headings, modulo 90 degrees, and its standard deviation."""
        one, two, of = 2 * reference + 1, 2 * row + 1, self.covariance
        heading = self.heading[[reference, row]] + self.change[[one, two]]
        variance = float(of[one, one] + of[two, two] - 2.0 * of[one, two])
        return math.remainder(float(heading[1] - heading[0]), 0.5 * math.pi), math.sqrt(max(variance, 0.0))


def _changed(wall_map: WallMap, change: Floats, covariance: Floats) -> WallMap:
    """Return a map with walls moved by changes (2 n,) of offset and heading, with their new joint covariance.

    Corners that were at the intersection of two walls follow it.
    """
    walls = wall_map.walls
    offset, turn = change[::2], change[1::2]
    x, y, heading = walls.frame.T
    frame = np.column_stack([x - np.sin(heading) * offset, y + np.cos(heading) * offset, heading + turn])
    rows = np.arange(len(walls))
    blocks = covariance.reshape(len(walls), 2, len(walls), 2)[rows, :, rows, :]
    moved = replace(wall_map, walls=replace(walls, frame=frame, covariance=blocks), covariance=covariance)
    return replace(moved, corners=_corners(wall_map, moved))


def _corners(before: WallMap, after: WallMap) -> MapCorners:
    """Return the corners of a map whose walls were moved, with their covariances."""
    corners, row = before.corners, {int(identity): k for k, identity in enumerate(before.walls.identity)}
    position, covariance = corners.position.copy(), corners.covariance.copy()
    for k, (one, two) in enumerate(corners.walls.tolist()):
        first, second = row.get(one), row.get(two)
        if first is None or second is None or are_parallel(before, first, second):
            continue
        shift = after.intersection(first, second)[0] - before.intersection(first, second)[0]
        jacobian = after.intersection(first, second)[1]
        position[k] += shift
        covariance[k] = jacobian @ after.covariance @ jacobian.T
    return replace(corners, position=position, covariance=covariance)
