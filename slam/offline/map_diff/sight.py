"""Which walls of one map the scans of another one have seen, and which they have seen through.

A scan votes that a stretch of a wall is there if its points lie on at least as much of the stretch as it sees through;
else it votes that the stretch is not there. If nothing has changed, scans of both drives see through it with the same
probability: that of glass, of a grating, or nearly zero. Given the total number of scans that see through it, the
number of those of one drive then has a hypergeometric distribution (Fisher's exact test).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.immutable import immutable
from features.normal_limits import NORMAL_LIMIT

from ...geometry.segments import Floats, Integers
from ...mapping.sight_lines import MIN_DEPTH, trace_sight_lines
from ...mapping.wall_cells import END_ERROR_CELLS, ON_WALL_DISTANCE, WALL_CELL
from ...mapping.wall_removal import MIN_OPENING
from ...measuring.wall_map import WallGeometry
from .exact_test import Votes, exact_p_value
from .surveys import Survey

Gate = tuple[float, float]


@immutable
class SeenThrough:
    """Stretch of a wall that scans have seen through.

    wall     row of the wall
    span     begin and end, metres along the wall from its frame
    through  scans of the other drive that have seen through it
    seen     scans of the other drive that have seen it
    own      (2,) the same of the drive that the wall was mapped in
    """

    wall: int
    span: tuple[float, float]
    through: int
    seen: int
    own: tuple[int, int]

    @property
    def p_value(self) -> float:
        """Probability that so many scans of the other drive see through it, or more, if nothing has changed."""
        return exact_p_value(Votes(self.through, self.seen), Votes(*self.own))


@immutable
class Sightings:
    """What the scans of one map show of the walls of another one.

    stretches  that were seen through more often than seen
    seen       (n,) metres of each wall on which scans have seen points more often than seen through
    looked_at  (n,) metres of each wall that scans have seen or seen through
    """

    stretches: list[SeenThrough]
    seen: Floats
    looked_at: Floats

    @property
    def walls_not_seen_through(self) -> int:
        """Number of walls that scans have looked at and that have no stretch: tests without evidence of a change."""
        return int((self.looked_at > 0.0).sum()) - len({stretch.wall for stretch in self.stretches})


def find_sightings(owner: Survey, survey: Survey, motion: se2.Pose) -> Sightings:
    """Return what the scans of `survey` show of the walls of the map of `owner`, in which its map is at `motion`.

    Only cells count that the owner's own scans saw: a line fitted to what is on both sides of a door covers the door.
    """
    cells = _Cells(owner.wall_map)
    through, seen = cells.counts(survey, motion, np.arange(len(owner.wall_map.walls)))
    looked_at = np.unique(cells.wall[through + seen > 0])  # few of the walls of a large plan
    own_through, own_seen = cells.counts(owner, np.zeros(3), looked_at)
    cells.restrict(own_seen > own_through)
    through, seen = np.where(cells.inner, through, 0), np.where(cells.covered, seen, 0)
    spans = list(_runs(cells, through > seen))
    votes, own = cells.votes(spans, survey, motion), cells.votes(spans, owner, np.zeros(3))
    stretches = [
        SeenThrough(int(cells.wall[first]), cells.span(first, last), *votes[k], own[k])
        for k, (first, last) in enumerate(spans)
        if votes[k][0] > votes[k][1]
    ]
    known = cells.covered & (through + seen > 0)
    return Sightings(stretches, cells.lengths(known & (seen >= through)), cells.lengths(known))


def covered_share(
    wall_map: WallGeometry, stretch: SeenThrough, other: WallGeometry, motion: se2.Pose, gate: Gate
) -> float:
    """Return the share of a stretch that a wall of another map, which is at `motion`, covers; 1 is all of it.

    gate  metres across and radians within which two walls are the same
    """
    frame = wall_map.walls.frame[stretch.wall]
    low, high = stretch.span
    relative = se2.between(frame, se2.compose(motion, other.walls.frame)).reshape(-1, 3)
    offset = relative[:, 1] + (0.5 * (low + high) - relative[:, 0]) * np.tan(relative[:, 2])
    share = 0.0
    for row in np.flatnonzero((np.abs(offset) < gate[0]) & (np.abs(relative[:, 2]) < gate[1])).tolist():
        pieces = other.walls.pieces[row] + relative[row, 0]
        common = np.minimum(pieces[:, 1], high) - np.maximum(pieces[:, 0], low)
        share = max(share, float(np.maximum(common, 0.0).sum()) / (high - low))
    return share


class _Cells:
    """Cells of WALL_CELL metres along all walls, one wall after the other.

    wall     row of the wall of each cell
    covered  true for cells that were observed
    inner    true for covered cells that are not at an end of an observed piece
    """

    def __init__(self, wall_map: WallGeometry) -> None:
        walls = wall_map.walls
        self._wall_map = wall_map
        self._first = np.floor(walls.low / WALL_CELL).astype(np.int64)
        sizes = np.ceil(walls.high / WALL_CELL).astype(np.int64) - self._first
        self._ends = np.concatenate([[0], np.cumsum(sizes)])
        self.count = int(self._ends[-1])
        self.wall = np.repeat(np.arange(len(walls)), sizes)
        self.covered, self.inner = np.zeros(self.count, dtype=bool), np.zeros(self.count, dtype=bool)
        for row, pieces in enumerate(walls.pieces):
            for low, high in (self._ends[row] + np.round(pieces / WALL_CELL).astype(int) - self._first[row]).tolist():
                margin = min(END_ERROR_CELLS, max(high - low - 1, 0) // 4)
                begin, end = max(low, int(self._ends[row])), min(high, int(self._ends[row + 1]))
                self.covered[begin:end] = True
                self.inner[begin + margin : end - margin] = True
        along = self._along(np.arange(self.count)) + 0.5 * WALL_CELL
        covariance = walls.covariance[self.wall]
        variance = covariance[:, 0, 0] + 2.0 * along * covariance[:, 0, 1] + along**2 * covariance[:, 1, 1]
        self._min_depth = MIN_DEPTH + NORMAL_LIMIT * np.sqrt(variance)

    def _along(self, cells: Integers) -> Floats:
        """Return the metres from the frame of its wall to the begin of each cell."""
        walls = self.wall[cells]
        return np.asarray(WALL_CELL * (self._first[walls] + cells - self._ends[walls]))

    def span(self, first: int, last: int) -> tuple[float, float]:
        """Return begin and end of successive cells of a wall, metres along it from its frame."""
        begin, end = self._along(np.array([first, last])).tolist()
        return begin, end + WALL_CELL

    def lengths(self, chosen: NDArray[np.bool_]) -> Floats:
        """Return for each wall the metres of its chosen cells."""
        return np.asarray(WALL_CELL * np.bincount(self.wall[chosen], minlength=len(self._first)))

    def restrict(self, chosen: NDArray[np.bool_]) -> None:
        """Treat all cells but some chosen ones as not observed."""
        self.covered &= chosen
        self.inner &= chosen

    def counts(self, survey: Survey, motion: se2.Pose, walls: Integers) -> tuple[Integers, Integers]:
        """Return how many scans see through each cell of some walls (rows), and how many see it."""
        through, seen = np.zeros(self.count, dtype=np.int64), np.zeros(self.count, dtype=np.int64)
        for cells, is_through, is_seen in self.scans(survey, motion, walls):
            through[cells] += is_through
            seen[cells] += is_seen
        return through, seen

    def votes(self, spans: list[tuple[int, int]], survey: Survey, motion: se2.Pose) -> list[tuple[int, int]]:
        """Return for each span of cells, first and last, how many scans see through it, and how many see it."""
        votes = np.zeros((len(spans), 2), dtype=np.int64)
        first, last = np.array(spans, dtype=np.int64).reshape(-1, 2).T
        for cells, *shown in self.scans(survey, motion, np.unique(self.wall[first])):
            begin, end = np.searchsorted(cells, first), np.searchsorted(cells, last + 1)
            sums = [np.concatenate([[0], np.cumsum(one)]) for one in shown]
            crossed, hit = (one[end] - one[begin] for one in sums)
            votes += np.column_stack([crossed > hit, (hit > 0) & (hit >= crossed)])
        return [(through, seen) for through, seen in votes.tolist()]

    def scans(
        self, survey: Survey, motion: se2.Pose, walls: Integers
    ) -> Iterator[tuple[Integers, NDArray[np.bool_], NDArray[np.bool_]]]:
        """Yield for each scan with one of some walls (rows, ascending) within reach the cells of those that are.

        With the cells come which of them the scan sees through, and which it sees.
        """
        frames = self._wall_map.walls.frame[walls]
        low, high = self._wall_map.walls.low[walls], self._wall_map.walls.high[walls]
        middle = np.asarray(se2.compose(frames, np.column_stack([0.5 * (low + high), np.zeros((len(walls), 2))])))
        for pose, points in zip(se2.compose(motion, survey.poses).reshape(-1, 3), survey.points, strict=True):
            reach = float(np.hypot(points[:, 0], points[:, 1]).max(initial=0.0)) + ON_WALL_DISTANCE
            far = np.hypot(middle[:, 0] - pose[0], middle[:, 1] - pose[1]) > reach + 0.5 * (high - low) + WALL_CELL
            near = np.flatnonzero(~far)
            if not len(near):
                continue
            begin, sizes = self._ends[walls[near]], np.diff(self._ends)[walls[near]]
            ends = np.concatenate([[0], np.cumsum(sizes)])
            cells = np.arange(ends[-1]) + np.repeat(begin - ends[:-1], sizes)
            seen, depth, _ = trace_sight_lines(pose, points, frames[near], self._first[walls[near]], ends)
            yield cells, self.inner[cells] & (depth > self._min_depth[cells]), self.covered[cells] & seen


def _runs(cells: _Cells, chosen: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Yield the first and last cell of each run of chosen cells in one wall that is long enough for an opening.

    Gaps of up to END_ERROR_CELLS do not divide a run. A run that is all that is observed of a short wall is long
    enough.
    """
    rows = np.flatnonzero(chosen)
    if not len(rows):
        return
    breaks = np.flatnonzero((np.diff(rows) > END_ERROR_CELLS + 1) | (np.diff(cells.wall[rows]) > 0))
    for run in np.split(rows, breaks + 1):
        inner = int((cells.inner & (cells.wall == cells.wall[run[0]])).sum())
        if len(run) >= min(round(MIN_OPENING / WALL_CELL), inner):
            yield int(run[0]), int(run[-1])
