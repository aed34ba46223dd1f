"""Compare each scan with earlier passes of the same place: they saw through its walls, or saw walls where it sees none.

Each cell of a grid has the distance driven when a sight line crossed it first, and when a point hit it first. This
shows whether an earlier pass, some metres of driving before, saw the cell free or occupied. Later passes are left out.
If a place is mapped a second time with a displacement, only the first scans there contradict the map: later ones agree
with one of both.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from drivers.compiled import compiled
from drivers.elapsed import elapsed
from drivers.immutable import immutable

from ..geometry.segments import Floats, Integers
from ..geometry.surroundings import CORRIDOR_LENGTH
from ..mapping.sight_lines import MIN_DEPTH
from .distance_rings import CELL
from .drive import Drive
from .row_groups import MAX_GAP, consecutive_groups
from .suspect import MAP, Suspect

# Metres of driving between two passes of a place. Origin: definition, the length of a corridor.
PASS_DISTANCE = CORRIDOR_LENGTH
# Metres; sight lines and points beyond are left out: half a degree moves them by more than a cell. Origin: chosen.
MAX_RANGE = 15.0
# Cells of the grid at most: larger areas have cells larger than CELL. Origin: numerical, 16 MB in two grids.
MAX_CELLS = 2_000_000
# Cells around a hit that count as occupied too. Origin: chosen, two: 0.2 m, the blur of a usable map.
BLUR = 2
# Cells of occupied space that a sight line crosses where it crosses a wall: fewer is the edge of something, more is a
# line along the wall. Origin: geometry, 2 BLUR + 1 cells seen at 45 to 90 degrees.
MIN_CROSSING, MAX_CROSSING = BLUR + 1, math.ceil((2 * BLUR + 1) * math.sqrt(2.0))
# Share of a scan's points that must be where an earlier pass was. Origin: chosen; not measured.
MIN_COMMON = 0.3
# Share of these points that contradict earlier passes in both ways. Where people stood, points lie in space seen
# through, but no wall is crossed; where a door was opened, a wall is crossed, but no such point is there.
# Origin: tuned on fhw, edmonton, CSAIL, Intel and fr079. In right maps (also by GMapping, LaMa) scans reach 0.22;
# in the wrong maps of fhw and edmonton 0.24 and 0.35. So the next two conditions are needed as well.
MAX_CONTRADICTION = 0.1
# Scans in a row that make a suspect, if more of their points contradict earlier passes than agree with them.
# Origin: tuned on the same recordings. In right maps there are up to 5 scans in a row (fr079), with 0.7 contradicting
# points per agreeing one, and 2 in a row with 1.01 (Intel); in the wrong maps of fhw and edmonton 1.03 and 1.8.
MIN_SCANS = 3


@immutable
class Contradictions:
    """What each of n scans has in common with earlier passes, in numbers of points.

    seen_through  (n,) points in space that an earlier pass saw through
    crossing      (n,) points behind a wall of an earlier pass
    agreeing      (n,) points on something that an earlier pass hit
    total         (n,) all points
    earlier       (n,) metres driven at the pass that saw through
    """

    seen_through: Integers
    crossing: Integers
    agreeing: Integers
    total: Integers
    earlier: Floats

    @property
    def common(self) -> Integers:
        """(n,) points that are where an earlier pass was."""
        return self.seen_through + self.crossing + self.agreeing

    @property
    def share(self) -> Floats:
        """(n,) share of the common points that contradict earlier passes in both ways, zero if too few are common."""
        both = np.minimum(self.seen_through, self.crossing) / np.maximum(self.common, 1)
        return np.where(self.common >= MIN_COMMON * self.total, both, 0.0)


def contradicting_passes(drive: Drive) -> Iterator[Suspect]:
    """Yield the intervals of a sampled drive in which the scans contradict earlier passes of the same place."""
    travelled = drive.travelled()
    found = compare_passes(drive, travelled)
    share, common = found.share, np.maximum(found.common, 1)
    for group in consecutive_groups(np.flatnonzero(share > MAX_CONTRADICTION), MAX_GAP):
        contradicting = (found.seen_through + found.crossing)[group].sum()
        if len(group) < MIN_SCANS or contradicting <= found.agreeing[group].sum():
            continue
        worst = int(group[np.argmax(share[group])])
        earlier = drive.stamps[min(int(np.searchsorted(travelled, found.earlier[worst])), len(drive) - 1)]
        seen_through, crossing = (100 * part[worst] / common[worst] for part in (found.seen_through, found.crossing))
        before = f"around {elapsed(earlier - drive.start)}" if earlier >= drive.start else "of an earlier session"
        text = (
            f"the map does not fit together: {seen_through:.0f} % of the scan's points are where the scans {before} "
            f"saw through, and {crossing:.0f} % of its sight lines cross walls of earlier passes"
        )
        weight = float(share[group].sum()) / (MIN_SCANS * MAX_CONTRADICTION)
        first, last = float(drive.stamps[group[0]]), float(drive.stamps[group[-1]])
        yield Suspect(MAP, float(drive.stamps[worst]), first, last, drive.poses[worst, :2], weight, text)


def compare_passes(drive: Drive, travelled: Floats) -> Contradictions:
    """Compare each scan of a sampled drive with earlier passes; `travelled` (n,) metres."""
    low = drive.poses[:, :2].min(axis=0) - MAX_RANGE
    size = drive.poses[:, :2].max(axis=0) + MAX_RANGE - low
    cell = max(CELL, math.sqrt(float(size.prod()) / MAX_CELLS))
    rows, columns = (math.floor(extent / cell) + 1 for extent in size)
    free, hit = (np.full((rows, columns), np.inf, dtype=np.float32) for _ in range(2))
    in_grid = (drive.poses - np.array([*low, 0.0])) * np.array([1.0 / cell, 1.0 / cell, 1.0])
    for points, pose, at in zip(drive.points, in_grid, travelled, strict=True):
        _enter(free, hit, points / cell, pose, at, MAX_RANGE / cell, MIN_DEPTH / cell)
    counts, earlier = np.zeros((len(drive), 3), dtype=np.int64), np.zeros(len(drive))
    for k, (points, pose, at) in enumerate(zip(drive.points, in_grid, travelled, strict=True)):
        earlier[k] = _compare(free, hit, points / cell, pose, at, MAX_RANGE / cell, MIN_DEPTH / cell, counts[k])
    total = np.array([len(points) for points in drive.points])
    return Contradictions(counts[:, 0], counts[:, 1], counts[:, 2], total, earlier)


@compiled
def _note(first, i, j, at):  # type: ignore[no-untyped-def]
    if 0 <= i < first.shape[0] and 0 <= j < first.shape[1] and at < first[i, j]:
        first[i, j] = at


@compiled
def _on_earlier_pass(first, i, j, at):  # type: ignore[no-untyped-def]
    """Return True if something happened in a cell on an earlier pass."""
    return 0 <= i < first.shape[0] and 0 <= j < first.shape[1] and first[i, j] < at - PASS_DISTANCE


@compiled
def _enter(free, hit, points, pose, at, reach, margin):  # type: ignore[no-untyped-def]
    """Note the cells that a scan's sight lines cross and its points hit; all lengths are in cells."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for p in range(len(points)):
        length = math.hypot(points[p, 0], points[p, 1])
        dx = (c * points[p, 0] - s * points[p, 1]) / max(length, 1e-9)
        dy = (s * points[p, 0] + c * points[p, 1]) / max(length, 1e-9)
        for step in range(int(min(length, reach) - margin)):
            _note(free, math.floor(pose[0] + dx * step), math.floor(pose[1] + dy * step), at)
        if length > reach:
            continue
        row, column = math.floor(pose[0] + dx * length), math.floor(pose[1] + dy * length)
        for i in range(row - BLUR, row + BLUR + 1):
            for j in range(column - BLUR, column + BLUR + 1):
                _note(hit, i, j, at)


@compiled
def _compare(free, hit, points, pose, at, reach, margin, counts):  # type: ignore[no-untyped-def]
    """Count a scan's points in space seen through, behind walls, and on walls of earlier passes; all in cells.

    Return the metres driven at the pass that saw through, averaged over these points.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    driven = 0.0
    for p in range(len(points)):
        length = math.hypot(points[p, 0], points[p, 1])
        dx = (c * points[p, 0] - s * points[p, 1]) / max(length, 1e-9)
        dy = (s * points[p, 0] + c * points[p, 1]) / max(length, 1e-9)
        if length <= reach:
            row, column = math.floor(pose[0] + dx * length), math.floor(pose[1] + dy * length)
            if _on_earlier_pass(hit, row, column, at):
                counts[2] += 1
                continue
            through = True
            for i in range(row - 1, row + 2):
                for j in range(column - 1, column + 2):
                    through = through and _on_earlier_pass(free, i, j, at)
            if through:
                counts[0] += 1
                driven += free[row, column]
                continue
        run = 0
        for step in range(int(min(length, reach)) + 1):
            if _on_earlier_pass(hit, math.floor(pose[0] + dx * step), math.floor(pose[1] + dy * step), at):
                run += 1
            elif MIN_CROSSING <= run <= MAX_CROSSING and step < length - margin:
                counts[1] += 1
                break
            else:
                run = 0
    return driven / max(1, counts[0])
