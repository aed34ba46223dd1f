"""Compare what different passes of one place saw: walls of one pass that another one saw through.

For each cell of a grid, the first and the last time that sight lines crossed it and that points hit it are stored, in
metres driven. That is enough to know whether another pass, some driving before or after, saw it free or occupied.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import compiled

from ..geometry.segments import Floats, Integers
from .drive import Drive, consecutive_groups
from .suspect import MAP, Suspect

# Metres of driving between two passes of a place. Origin: chosen, more than one room; not measured.
PASS_DISTANCE = 20.0
# Metres; sight lines and points beyond are left out: half a degree moves them by more than a cell. Origin: chosen.
MAX_RANGE = 15.0
# Metres, least side of a cell. Origin: chosen, a few times the noise of lidars; not measured.
MIN_CELL = 0.1
# Cells of the grid at most: larger areas have larger cells. Origin: numerical, 32 MB in four grids.
MAX_CELLS = 2_000_000
# Metres before its end at which a sight line stops to show free space, and after a wall's crossing that it must go on:
# slanting walls and pose errors. Origin: chosen, as in `slam.mapping.sight_lines`; not measured.
MARGIN = 0.3
# Cells around a hit that count as occupied too. Origin: chosen, two: 0.2 m, the blur of a usable map.
BLUR = 2
# Cells of occupied space that a sight line crosses where it crosses a wall: fewer is the edge of something, more is a
# line along the wall. Origin: geometry, 2 BLUR + 1 cells seen at 45 to 90 degrees.
MIN_CROSSING, MAX_CROSSING = BLUR + 1, math.ceil((2 * BLUR + 1) * math.sqrt(2.0))
# Share of a scan's points that must be where another pass was. Origin: chosen; not measured.
MIN_COMMON = 0.3
# Share of these points that contradict the other pass in both ways. Where people stood, points lie in space seen
# through, but no wall is crossed; where a door was opened, a wall is crossed, but no such point is there.
# Origin: measured: in right maps (GMapping and LaMa on fhw, with a crowd, and edmonton; Intel, CSAIL) single scans
# reach 0.11, and never MIN_SCANS in a row; in the bent ones of the same drives it is 0.2 to 0.3.
MAX_CONTRADICTION = 0.1
# Scans in a row that make a suspect, if more of their points contradict other passes than agree with them. A single
# scan may be blurred. Origin: chosen, about a metre of driving.
MIN_SCANS = 3
# Scans without contradiction that may lie between two of one interval. Origin: chosen, about a metre.
MAX_GAP = 3


@dataclass(frozen=True, slots=True, eq=False)
class Contradictions:
    """What each of n scans has in common with other passes, in numbers of points.

    seen_through  (n,) points in space that another pass saw through
    crossing      (n,) points behind a wall of another pass
    agreeing      (n,) points on something that another pass hit
    total         (n,) all points
    other         (n,) metres driven at the pass that saw through
    """

    seen_through: Integers
    crossing: Integers
    agreeing: Integers
    total: Integers
    other: Floats

    @property
    def common(self) -> Integers:
        """(n,) points that are where another pass was."""
        return self.seen_through + self.crossing + self.agreeing

    @property
    def share(self) -> Floats:
        """(n,) share of the common points that contradict other passes in both ways, zero if too few are common."""
        both = np.minimum(self.seen_through, self.crossing) / np.maximum(self.common, 1)
        return np.where(self.common >= MIN_COMMON * self.total, both, 0.0)


def contradicting_passes(drive: Drive) -> Iterator[Suspect]:
    """Yield the intervals of a sampled drive in which the scans contradict other passes of the same place."""
    travelled = drive.travelled()
    found = compare_passes(drive, travelled)
    share, common = found.share, np.maximum(found.common, 1)
    for group in consecutive_groups(np.flatnonzero(share > MAX_CONTRADICTION), MAX_GAP):
        contradicting = (found.seen_through + found.crossing)[group].sum()
        if len(group) < MIN_SCANS or contradicting <= found.agreeing[group].sum():
            continue
        worst = int(group[np.argmax(share[group])])
        other = drive.stamps[min(int(np.searchsorted(travelled, found.other[worst])), len(drive) - 1)]
        seen_through, crossing = (100 * part[worst] / common[worst] for part in (found.seen_through, found.crossing))
        text = (
            f"the map does not fit together: {seen_through:.0f} % of the scan's points are where the scans around "
            f"{other:.1f} s saw through, and {crossing:.0f} % of its sight lines cross walls of other passes"
        )
        weight = float(share[group].sum()) / (MIN_SCANS * MAX_CONTRADICTION)
        first, last = float(drive.stamps[group[0]]), float(drive.stamps[group[-1]])
        yield Suspect(MAP, float(drive.stamps[worst]), first, last, drive.poses[worst, :2], weight, text)


def compare_passes(drive: Drive, travelled: Floats) -> Contradictions:
    """Compare each scan of a sampled drive with the other passes; `travelled` (n,) metres."""
    low = drive.poses[:, :2].min(axis=0) - MAX_RANGE
    size = drive.poses[:, :2].max(axis=0) + MAX_RANGE - low
    cell = max(MIN_CELL, math.sqrt(float(size.prod()) / MAX_CELLS))
    rows, columns = (math.floor(extent / cell) + 1 for extent in size)
    free, hit = (_empty_times(rows, columns) for _ in range(2))
    in_grid = (drive.poses - np.array([*low, 0.0])) * np.array([1.0 / cell, 1.0 / cell, 1.0])
    for points, pose, at in zip(drive.points, in_grid, travelled, strict=True):
        _enter(free, hit, points / cell, pose, at, MAX_RANGE / cell, MARGIN / cell)
    counts, other = np.zeros((len(drive), 3), dtype=np.int64), np.zeros(len(drive))
    for k, (points, pose, at) in enumerate(zip(drive.points, in_grid, travelled, strict=True)):
        other[k] = _compare(free, hit, points / cell, pose, at, MAX_RANGE / cell, MARGIN / cell, counts[k])
    total = np.array([len(points) for points in drive.points])
    return Contradictions(counts[:, 0], counts[:, 1], counts[:, 2], total, other)


def _empty_times(rows: int, columns: int) -> NDArray[np.float32]:
    """Return (2, rows, columns) first and last time, before anything happened."""
    times = np.full((2, rows, columns), np.inf, dtype=np.float32)
    times[1] = -np.inf
    return times


@compiled
def _note(times, i, j, at):  # type: ignore[no-untyped-def]
    if 0 <= i < times.shape[1] and 0 <= j < times.shape[2]:
        times[0, i, j] = min(times[0, i, j], at)
        times[1, i, j] = max(times[1, i, j], at)


@compiled
def _in_other_pass(times, i, j, at):  # type: ignore[no-untyped-def]
    """Return True if something happened in a cell on another pass."""
    if not (0 <= i < times.shape[1] and 0 <= j < times.shape[2]):
        return False
    return times[0, i, j] < at - PASS_DISTANCE or times[1, i, j] > at + PASS_DISTANCE


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
    """Count a scan's points in space seen through, behind walls, and on walls of other passes; all lengths in cells.

    Return the time of the pass that saw through, averaged over these points.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    times = 0.0
    for p in range(len(points)):
        length = math.hypot(points[p, 0], points[p, 1])
        dx = (c * points[p, 0] - s * points[p, 1]) / max(length, 1e-9)
        dy = (s * points[p, 0] + c * points[p, 1]) / max(length, 1e-9)
        if length <= reach:
            row, column = math.floor(pose[0] + dx * length), math.floor(pose[1] + dy * length)
            if _in_other_pass(hit, row, column, at):
                counts[2] += 1
                continue
            through = True
            for i in range(row - 1, row + 2):
                for j in range(column - 1, column + 2):
                    through = through and _in_other_pass(free, i, j, at)
            if through:
                counts[0] += 1
                first, last = free[0, row, column], free[1, row, column]
                times += first if first < at - PASS_DISTANCE else last
                continue
        run = 0
        for step in range(int(min(length, reach)) + 1):
            if _in_other_pass(hit, math.floor(pose[0] + dx * step), math.floor(pose[1] + dy * step), at):
                run += 1
            elif MIN_CROSSING <= run <= MAX_CROSSING and step < length - margin:
                counts[1] += 1
                break
            else:
                run = 0
    return times / max(1, counts[0])
