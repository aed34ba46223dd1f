"""Which ends of walls have moved along their wall, such as the jambs of a door.

Two statements must hold: the places of the end in both maps differ significantly, given the joint covariances of both
maps, and the scans of one drive have seen the wall where those of the other one have seen through its line. The p-value
is the larger one of both (intersection-union test).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ...geometry.normal_distribution import NORMAL_MEDIAN
from ...geometry.segments import Floats
from ..wall_alignment import numerical_jacobian
from .ends import REACH, WallEnd, find_ends, walls_of_scan
from .exact_test import Votes, exact_p_value
from .movement import Movements, levers
from .surveys import Survey

# Ends at least whose median is the typical difference: with fewer, the median may be that of an end that has moved.
# Origin: definition, the smaller one of two is that of an end that has not moved.
MIN_TYPICAL = 2


@immutable
class EndShift:
    """An end of a wall that both drives have seen.

    walls    rows of the wall in the old and in the new map
    span     (2,) metres along the old wall from its frame: the end in the old map, and in the new one
    longer   metres by which the wall is longer in the new map; negative if it is shorter
    sigma    standard deviation
    p_value  probability of such evidence if the end has not moved
    through  scans that have seen through the wall's line between both places, in the drive where it is shorter
    seen     scans of that drive that have seen the wall there
    """

    walls: tuple[int, int]
    span: tuple[float, float]
    longer: float
    sigma: float
    p_value: float
    through: int
    seen: int


def find_end_shifts(old: Survey, new: Survey, movements: Movements) -> list[EndShift]:
    """Return the ends that both drives have seen of the walls that the maps have in common."""
    pairs = movements.pairs
    maps = _TwoMaps(old, new, movements)
    matched = _match(find_ends(old, pairs[:, 0]), find_ends(new, pairs[:, 1]), maps)
    if not matched:
        return []
    differences = np.array([maps.difference(*ends) for ends in matched])
    squared = np.sort(differences[:, 0] ** 2 / differences[:, 1])
    typical = float(squared[(len(squared) - 1) // 2]) if len(squared) >= MIN_TYPICAL else 0.0
    differences[:, 1] *= max(typical / NORMAL_MEDIAN, 1.0)
    votes = zip(*maps.votes(matched), strict=True)
    return [_shift(ends, maps, *row) for ends, *row in zip(matched, differences.tolist(), votes, strict=True)]


class _TwoMaps:
    """Two aligned maps, in which ends of walls are compared."""

    def __init__(self, old: Survey, new: Survey, movements: Movements) -> None:
        self.old, self.new, self.movements = old, new, movements
        self._levers_old = levers(len(old.wall_map.walls), movements.pairs[:, 0], movements.points[:, 0])
        self._levers_new = levers(len(new.wall_map.walls), movements.pairs[:, 1], movements.points[:, 1])

    def along_old(self, end: WallEnd, wall: int) -> float:
        """Return the metres along a wall of the old map of an end in the new map."""
        return self._along_old(end, wall, self.movements.motion)

    def along_new(self, end: WallEnd, wall: int) -> float:
        """Return the metres along a wall of the new map of an end in the old map."""
        point = self.old.wall_map.point(end.wall, end.along)
        return self.new.wall_map.along(wall, se2.transform(se2.inverse(self.movements.motion), point))

    def difference(self, before: WallEnd, after: WallEnd) -> tuple[float, float, float]:
        """Return by how many metres an end is farther along the old wall in the new map, the variance, and its dof.

        Both maps' walls determine the place of the end, by the poses of the scans, and the motion between the maps.
        """

        def shifted(change: Floats) -> Floats:
            motion = se2.compose(self.movements.motion, change)
            return np.array([self._along_old(after, before.wall, motion) - before.along])

        by_motion = numerical_jacobian(shifted)[0] @ self.movements.gain
        of_maps = self.old.wall_map.sigma(before.gradient - by_motion @ self._levers_old) ** 2
        of_maps += self.new.wall_map.sigma(after.gradient - by_motion @ self._levers_new) ** 2
        variance = self.movements.scale * of_maps + sum(end.pose + end.scatter for end in (before, after))
        # Welch and Satterthwaite: only the scatter is estimated from few values
        estimated = sum(end.scatter**2 / (end.scans - 1) for end in (before, after))
        return float(shifted(np.zeros(3))[0]), variance, variance**2 / max(estimated, np.finfo(float).tiny)

    def votes(self, matched: Sequence[tuple[WallEnd, WallEnd]]) -> tuple[list[Votes], list[Votes]]:
        """Return how the scans of both drives see the wall between both places of each pair of ends."""
        in_old = [(one.wall, one.side, one.along, self.along_old(two, one.wall)) for one, two in matched]
        in_new = [(two.wall, two.side, self.along_new(one, two.wall), two.along) for one, two in matched]
        return _votes(self.old, np.array(in_old)), _votes(self.new, np.array(in_new))

    def _along_old(self, end: WallEnd, wall: int, motion: se2.Pose) -> float:
        return self.old.wall_map.along(wall, se2.transform(motion, self.new.wall_map.point(end.wall, end.along)))


def _match(before: Sequence[WallEnd], after: Sequence[WallEnd], maps: _TwoMaps) -> list[tuple[WallEnd, WallEnd]]:
    """Return the pairs of ends of the same wall and side that are mutually nearest, within REACH."""
    partner = dict(maps.movements.pairs.tolist())
    matched = []
    for wall, side in dict.fromkeys((end.wall, end.side) for end in before):
        ours = [end for end in before if (end.wall, end.side) == (wall, side)]
        theirs = [end for end in after if (end.wall, end.side) == (partner[wall], side)]
        if not theirs:
            continue
        there = np.array([maps.along_old(end, wall) for end in theirs])
        apart = np.abs(there - np.array([end.along for end in ours])[:, None])
        nearest, back = apart.argmin(axis=1), apart.argmin(axis=0)
        matched += [
            (ours[k], theirs[m]) for k, m in enumerate(nearest.tolist()) if back[m] == k and apart[k, m] < REACH
        ]
    return matched


def _shift(
    ends: tuple[WallEnd, WallEnd], maps: _TwoMaps, difference: Sequence[float], votes: tuple[Votes, Votes]
) -> EndShift:
    """Return a pair of ends, before and after, with the p-value of its shift.

    difference  of the ends, as from `_TwoMaps.difference`
    votes       of the scans of the old and of the new map
    """
    from scipy.special import stdtr  # only here: it loads slowly

    (before, after), (value, variance, freedom) = ends, difference
    sigma, longer = math.sqrt(variance), value * before.side
    shorter, other = votes if longer > 0.0 else votes[::-1]
    p_value = max(2.0 * float(stdtr(freedom, -abs(value) / sigma)), exact_p_value(shorter, other))
    walls, span = (before.wall, after.wall), (before.along, maps.along_old(after, before.wall))
    return EndShift(walls, span, longer, sigma, p_value, shorter.through, shorter.seen)


def _votes(survey: Survey, spans: Floats) -> list[Votes]:
    """Return how many scans of a survey see through stretches of walls' lines, and how many see the walls there.

    spans  (k, 4) row of the wall, side of its end as in `WallEnd`, and the ends of the stretch in metres along it, in
           either order

    Only scans that look along the wall towards its end count: from the other side, the jamb is near the wall's line.
    """
    walls, (wall, side) = survey.wall_map.walls, spans[:, :2].astype(np.int64).T
    low, high = np.sort(spans[:, 2:], axis=1).T
    chosen = np.unique(wall)
    votes = np.zeros((len(spans), 2), dtype=np.int64)
    for pose, points in zip(survey.poses, survey.points, strict=True):
        scan = walls_of_scan(walls, pose, points, chosen)
        row_of = np.full(len(walls), -1)
        row_of[scan.rows] = np.arange(len(scan.rows))
        in_front = np.flatnonzero(row_of[wall] >= 0)
        eye = scan.eye[row_of[wall[in_front]]]
        in_front = in_front[np.where(side[in_front] > 0, low[in_front] - eye, eye - high[in_front]) > 0.0]
        row = row_of[wall[in_front]]
        inside = (scan.place[row] > low[in_front, None]) & (scan.place[row] < high[in_front, None])
        crossed, hit = (scan.through[row] & inside).sum(axis=1), (scan.on[row] & inside).sum(axis=1)
        votes[in_front, 0] += crossed > hit
        votes[in_front, 1] += (hit > 0) & (hit >= crossed)
    return [Votes(*counts) for counts in votes.tolist()]
