"""Walls that are no longer where they were: what is seen through often enough is retired from the map.

A sight line from the robot to a point that it sees shows that nothing stands in between. For each decimetre of a wall
the looks are counted that saw through it; a look that sees something there takes back three of them. That is how
glass stays, which some looks see and some do not. Where a look may be mistaken about where it is, it does not count.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats, Integers
from .landmarks import WALL_CELL, Landmarks

STEP = 0.2  # metres between two looks that count: what is mistaken once is mistaken again from the same place
BEHIND = 0.3  # metres from a wall's line on either side, and as many standard deviations of it besides, where
BEHIND_SIGMAS = 3.0  # the robot and what it sees must be: what is nearer may be the wall itself, or something on it
STEEPEST = 0.7  # least sine of the angle between a sight line and a wall: glass is seen only from opposite
SAME = 0.15  # metres across a wall within which what is seen is the wall
TAKEN_BACK = 3  # looks that saw through a place, by one that sees something there
MOST_ASKED = 6  # looks that must have seen through a place; fewer where the wall itself was not seen that often
MARGIN = 2  # cells from a wall's end or from a gap in it, where sight lines may have passed it by
GAP = 2  # cells not looked at between two that were seen through
LEAST_OPENING = 0.5  # metres of wall that are opened: a door, not a hole between two beams
LEAST_LEFT, LEAST_LEFT_SHARE, MOST_LEFT = 0.3, 1 / 3, 1.0  # metres, share, metres: of a wall; less than that is none
RECENT_WAY = 15.0  # metres of driving, in which the map does not bend
# Metres of wall, known no later than the doubted one, that a look must see in every direction; and how many times as
# many as it sees through. A robot that has drifted, or is elsewhere, sees through a lot.
LEAST_TIE, MORE_SEEN = 1.0, 3.0
SUSPENDED_WAY = 3.0  # metres of driving for which nothing counts where the robot may be elsewhere: two looks for a loop


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """What one look saw of the n walls around: their identities, and their `rows` in the table of walls.

    `first` (n,) is the first of a wall's cells; in the flat arrays its cells are from ends[k] to ends[k + 1]: whether
    each was `seen`, and its `depth`, see `sight`. `length` (n,) are the metres seen of each.
    """

    walls: Integers
    rows: NDArray[np.void]
    first: Integers
    ends: Integers
    seen: NDArray[np.bool_]
    depth: Floats
    length: Floats

    def cells(self, row: int, chosen: NDArray[np.bool_]) -> Integers:
        """The cells of a wall that are chosen in the flat arrays."""
        return np.asarray(self.first[row] + chosen[self.ends[row] : self.ends[row + 1]].nonzero()[0])


class FreeSpaceEvidence:
    """How many looks have seen through each place of each wall, on balance.

    counts  of a wall, by cell
    """

    def __init__(self, counts: Mapping[int, Mapping[int, int]] | None = None) -> None:
        self.counts: dict[int, dict[int, int]] = {wall: dict(cells) for wall, cells in (counts or {}).items()}
        self._stood: Floats | None = None
        self._suspended = -np.inf

    def __deepcopy__(self, memo: dict[int, object]) -> FreeSpaceEvidence:
        other = FreeSpaceEvidence(self.counts)
        other._stood, other._suspended = self._stood, self._suspended
        return other

    def clear(self) -> None:
        """The map has moved: what was counted was counted against another one."""
        self.counts, self._stood = {}, None

    def suspend(self, travel: float) -> None:
        """After so many metres of driving, another place explains more of what is seen than where the robot is believed
        to be: what was counted may be wrong, and what is seen next, too."""
        self.clear()
        self._suspended = travel

    def discard(self, walls: Sequence[int]) -> None:
        """Something is known of some walls that makes what was counted pointless."""
        for wall in walls:
            self.counts.pop(wall, None)

    def update(
        self,
        landmarks: Landmarks,
        pose: se2.Pose,
        points: Floats,
        travelled: Sequence[float],
        pose_covariances: Sequence[Floats],
    ) -> bool:
        """Look from `pose` at points (p, 2), in its own frame; retire what has been seen through often enough.

        `ways` and `pose_covariances` are the metres driven up to each keyframe and how well its pose was known, in the
        map's axes. Returns whether anything was retired.
        """
        if travelled[-1] - self._suspended < SUSPENDED_WAY:
            return False
        if self._stood is not None and np.hypot(*(pose[:2] - self._stood)) < STEP:
            return False
        self._stood = pose[:2].copy()
        look = _looked(landmarks, pose, np.ascontiguousarray(points))
        for row, wall in enumerate(look.walls.tolist()):
            if wall in self.counts and look.length[row]:
                self._take_back(wall, look.cells(row, look.seen))
        through = _seen_through(look, landmarks, pose, pose_covariances)
        removed_walls = False
        for row in _believed(look, through, travelled):
            wall = int(look.walls[row])
            counts = self.counts.setdefault(wall, {})
            for cell in through[row]:
                counts[cell] = counts.get(cell, 0) + 1
            removed_walls |= self._judge(landmarks, wall, len(travelled) - 1)
        return removed_walls

    def _take_back(self, wall: int, cells: Integers) -> None:
        """Some cells of a wall have been seen."""
        counts = self.counts[wall]
        for cell in counts.keys() & set(cells.tolist()):
            counts[cell] -= TAKEN_BACK
            if counts[cell] <= 0:
                del counts[cell]
        if not counts:
            del self.counts[wall]

    def _judge(self, landmarks: Landmarks, wall: int, keyframe: int) -> bool:
        """Retire a wall, or a stretch of it, if it has been seen through often enough."""
        observations = int(landmarks.walls.rows["observations"][wall])
        asked = min(MOST_ASKED, observations + 1)
        counts, covered = self.counts[wall], landmarks.covered[wall]
        gone = {cell for cell, count in counts.items() if count >= asked}
        if not gone:
            return False
        opened = landmarks.opened_cells(wall)  # which may go on
        stretches = _stretches(gone | opened, covered | opened)
        left = WALL_CELL * len(covered - frozenset(cell for stretch in stretches for cell in stretch))
        nothing_left = left < min(MOST_LEFT, max(LEAST_LEFT, LEAST_LEFT_SHARE * WALL_CELL * len(covered)))
        wide = [stretch for stretch in stretches if WALL_CELL * len(stretch) >= LEAST_OPENING]
        opening = covered.intersection(cell for stretch in wide for cell in stretch)
        if nothing_left or (opening and observations == 1):  # what was seen but once, and in part wrongly, was no wall
            landmarks.remove_wall(wall, keyframe)
            self.discard([wall])
        elif opening:
            landmarks.open_wall(wall, opening, keyframe)
            self.counts[wall] = {cell: count for cell, count in counts.items() if cell not in opening}
        return bool(nothing_left or opening)


def _looked(landmarks: Landmarks, pose: se2.Pose, points: Floats) -> _Look:
    """What is seen from a pose of the walls around, from whichever side."""
    every = landmarks.walls.rows
    reach = float(np.hypot(points[:, 0], points[:, 1]).max(initial=0.0))
    walls = _within(every["frame"], every["low"], every["high"], pose, reach).nonzero()[0]
    rows = every[walls]
    active = landmarks.active(walls)
    walls, rows = walls[active], rows[active]
    first = np.floor(rows["low"] / WALL_CELL).astype(np.int64)
    sizes = np.ceil(rows["high"] / WALL_CELL).astype(np.int64) - first
    ends = np.concatenate([[0], np.cumsum(sizes)])
    return _Look(walls, rows, first, ends, *sight(pose, points, rows["frame"].copy(), first, ends))


@njit(cache=True)
def _within(frames, lows, highs, pose, reach):  # type: ignore[no-untyped-def]
    """(n,) which walls have a part within reach of a pose."""
    within = np.zeros(len(frames), dtype=np.bool_)
    for wall in range(len(frames)):
        c, s = math.cos(frames[wall, 2]), math.sin(frames[wall, 2])
        dx, dy = pose[0] - frames[wall, 0], pose[1] - frames[wall, 1]
        along, across = c * dx + s * dy, c * dy - s * dx
        beyond = max(0.0, lows[wall] - along, along - highs[wall])
        within[wall] = beyond * beyond + across * across < reach * reach
    return within


@njit(cache=True)
def sight(pose, points, frames, first, ends):  # type: ignore[no-untyped-def]
    """What sight lines from a pose to points (p, 2), in its frame, show of walls: of n frames (n, 3), the first of the
    cells (n,) of each, and where they begin and end (n + 1,) in what is returned.

    Whether a point lies on a cell; for each cell the most, over the sight lines that go through it steeply enough, of
    the distance of their nearer end from the wall's line, 0 without one; and the metres (n,) of each wall that points
    lie on. A cell that is seen is not seen through.
    """
    seen, depth, length = np.zeros(ends[-1], dtype=np.bool_), np.zeros(ends[-1]), np.zeros(len(frames))
    for wall in range(len(frames)):
        c, s = math.cos(frames[wall, 2]), math.sin(frames[wall, 2])
        dx, dy = pose[0] - frames[wall, 0], pose[1] - frames[wall, 1]
        ex, ey = c * dx + s * dy, c * dy - s * dx  # the eye in the wall's frame
        c, s = math.cos(pose[2] - frames[wall, 2]), math.sin(pose[2] - frames[wall, 2])
        start, size = ends[wall], ends[wall + 1] - ends[wall]
        for p in range(len(points)):
            rise = s * points[p, 0] + c * points[p, 1]
            across = ey + rise
            near = abs(across) < SAME
            if not near and (ey * across > 0.0 or min(abs(across), abs(ey)) < BEHIND):
                continue
            run = c * points[p, 0] - s * points[p, 1]
            if not near:
                if abs(rise) < STEEPEST * math.hypot(run, rise):
                    continue
                run *= -ey / rise
            cell = math.floor((ex + run) / WALL_CELL) - first[wall]
            if 0 <= cell < size:
                if near:
                    seen[start + cell] = True
                else:
                    depth[start + cell] = max(depth[start + cell], min(abs(across), abs(ey)))
        for cell in range(start, start + size):
            if seen[cell]:
                depth[cell] = 0.0
                length[wall] += WALL_CELL
    return seen, depth, length


def _seen_through(
    look: _Look, landmarks: Landmarks, pose: se2.Pose, pose_covariances: Sequence[Floats]
) -> dict[int, list[int]]:
    """The cells that were seen through, by row: well within what is known of a wall, and far enough on either side.

    What is behind, and the eye before, must be farther from the wall's line than that is uncertain, as the wall was
    seen last, and by what the robot's own pose has lost in certainty since then; see `local_map_around`.
    """
    through: dict[int, list[int]] = {}
    rows = np.searchsorted(look.ends, look.depth.nonzero()[0], side="right") - 1
    for row in dict.fromkeys(rows.tolist()):
        wall, covered = look.rows[row], landmarks.covered[look.walls[row]]
        known = covered | landmarks.opened_cells(int(look.walls[row]))
        margin = min(MARGIN, (len(covered) - 1) // 4)
        depth = look.depth[look.ends[row] : look.ends[row + 1]]
        lost = pose_covariances[-1] - pose_covariances[wall["last_seen"]]
        deep = _deep(depth, look.first[row], wall["frame"].copy(), wall["covariance"].copy(), pose, lost)
        cells = (look.first[row] + deep.nonzero()[0]).tolist()
        around = range(-margin, margin + 1)
        cells = [cell for cell in cells if cell in covered and known.issuperset(cell + by for by in around)]
        if cells:
            through[row] = cells
    return through


@njit(cache=True)
def _deep(depth, first, frame, covariance, pose, lost):  # type: ignore[no-untyped-def]
    """(k,) of a wall's cells, which of them are seen through with enough `depth` for how uncertain the wall is there.

    `covariance` (2, 2) is the wall's, as it was seen last; `lost` (3, 3) what the pose has lost in certainty since.
    """
    c, s = math.cos(frame[2]), math.sin(frame[2])
    deep = np.zeros(len(depth), dtype=np.bool_)
    for cell in range(len(depth)):
        if depth[cell] > 0.0:
            along = WALL_CELL * (first + cell + 0.5)
            lever = c * (frame[0] - pose[0]) + s * (frame[1] - pose[1]) + along
            jacobian = np.array([-s, c, lever])
            variance = covariance[0, 0] + 2 * along * covariance[0, 1] + along * along * covariance[1, 1]
            variance += max(0.0, jacobian @ (lost @ jacobian))
            deep[cell] = depth[cell] > BEHIND + BEHIND_SIGMAS * math.sqrt(variance)
    return deep


def _believed(look: _Look, through: dict[int, list[int]], travelled: Sequence[float]) -> list[int]:
    """The rows of the walls of which it is believed that they were seen through.

    The look must see other walls, known no later than the doubted one was seen last, as far as the map may have bent
    since: in every direction, and more of them than it sees through.
    """
    if not through:
        return []
    against = np.zeros(len(look.walls))
    against[list(through)] = [WALL_CELL * len(cells) for cells in through.values()]
    lately = bisect_left(travelled, travelled[-1] - RECENT_WAY)
    rows = look.rows
    doubled = look.length * np.exp(2j * rows["frame"][:, 2])
    believed = []
    for row in through:
        known = rows["first_seen"] <= min(rows["last_seen"][row], max(rows["first_seen"][row], lately))
        seen = look.length[known].sum()
        tie = 0.5 * (seen - abs(doubled[known].sum()))  # the smaller eigenvalue of the sum of length n n'
        if tie >= LEAST_TIE and seen >= MORE_SEEN * against[known].sum():
            believed.append(row)
    return believed


def _stretches(gone: Set[int], known: Set[int]) -> list[list[int]]:
    """The known cells in stretches of some that are gone: with what lies between, and up to an end that is near."""
    ordered = np.sort(np.fromiter(gone, dtype=np.int64, count=len(gone)))
    stretches = []
    for part in np.split(ordered, np.flatnonzero(np.diff(ordered) > GAP + 1) + 1):
        low, high = int(part[0]), int(part[-1])
        before = [cell for cell in range(low - MARGIN - 1, low) if cell in known]
        after = [cell for cell in range(high + 1, high + MARGIN + 2) if cell in known]
        begin = low - MARGIN if len(before) <= MARGIN else low
        end = high + MARGIN if len(after) <= MARGIN else high
        stretches.append([cell for cell in range(begin, end + 1) if cell in known])
    return stretches
