"""Walls that are no longer where they were: what is seen through often enough is retired from the map.

A sight line from the robot to a point that it sees shows that nothing stands in between. For each decimetre of a wall
the looks are counted that saw through it; a look that sees something there takes back three of them. That is how
glass stays, which some looks see and some do not. Where a look may be mistaken about where it is, it does not count.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers import se2

from .landmarks import CELL, Landmarks
from .segments import Floats

Integers = NDArray[np.int64]

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
LEAST_LEFT, LEAST_LEFT_SHARE, MOST_LEFT = 0.3, 1 / 3, 1.0  # metres, share, metres: what is left of a wall and less is none
RECENT_WAY = 15.0  # metres of driving, in which the map does not bend
# Metres of wall, known no later than the doubted one, that a look must see in every direction; and how many times as
# many as it sees through. A robot that has drifted, or is elsewhere, sees through a lot.
LEAST_TIE, MORE_SEEN = 1.0, 2.0


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """What one look saw of the n walls around; `first` (n,) is the first of their cells, `ends` (n + 1,) where in the
    flat arrays a wall's cells begin: `seen`, and `depth`, metres between a wall's line and the nearer end of the sight
    line that went through the cell (0 without one). `drift` (n,) is the variance of the robot's place across the
    wall since that was seen last."""

    walls: Integers
    rows: NDArray[np.void]
    first: Integers
    ends: Integers
    seen: NDArray[np.bool_]
    depth: Floats
    eye: Floats

    def seen_length(self) -> Floats:
        """(n,) metres of each wall."""
        return np.asarray(CELL * np.add.reduceat(self.seen, self.ends[:-1], dtype=np.int64))

    def cells(self, row: int, chosen: NDArray[np.bool_]) -> Integers:
        """The cells of a wall that are chosen in the flat arrays."""
        return self.first[row] + np.flatnonzero(chosen[self.ends[row] : self.ends[row + 1]])


class Doubts:
    """How many looks have seen through each place of each wall, on balance.

    counts  of a wall, by cell
    """

    def __init__(self) -> None:
        self.counts: dict[int, dict[int, int]] = {}
        self._stood: Floats | None = None

    def __deepcopy__(self, memo: dict[int, object]) -> Doubts:
        other = Doubts()
        other.counts = {wall: dict(cells) for wall, cells in self.counts.items()}
        other._stood = self._stood
        return other

    def forget(self) -> None:
        """The map has moved: what was counted was counted against another one."""
        self.counts, self._stood = {}, None

    def settle(self, walls: Sequence[int]) -> None:
        """Something is known of some walls that makes what was counted pointless."""
        for wall in walls:
            self.counts.pop(wall, None)

    def look(
        self,
        landmarks: Landmarks,
        pose: se2.Pose,
        points: Floats,
        ways: Sequence[float],
        pose_covariances: Sequence[Floats],
    ) -> bool:
        """Look from `pose` at points (p, 2), in its own frame; retire what has been seen through often enough.

        `ways` and `pose_covariances` are the metres driven up to each keyframe and how well its pose was known, in the
        map's axes. Returns whether anything was retired.
        """
        if self._stood is not None and np.hypot(*(pose[:2] - self._stood)) < STEP:
            return False
        self._stood = pose[:2].copy()
        look = _looked(landmarks, pose, points)
        if look is None:
            return False
        for row in np.flatnonzero([wall in self.counts for wall in look.walls.tolist()]):
            self._take_back(int(look.walls[row]), look.cells(row, look.seen))
        through = _seen_through(look, landmarks, pose, pose_covariances)
        retired = False
        for wall in _believed(look, through, ways):
            counts = self.counts.setdefault(wall, {})
            for cell in through[wall]:
                counts[cell] = counts.get(cell, 0) + 1
            retired |= self._judge(landmarks, wall, len(ways) - 1)
        return retired

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
        asked = min(MOST_ASKED, int(landmarks.walls.rows["observations"][wall]) + 1)
        counts = self.counts[wall]
        gone = [cell for cell, count in counts.items() if count >= asked]
        if not gone:
            return False
        covered = landmarks.covered[wall]
        stretches = _stretches(sorted(gone), covered)
        left = CELL * (len(covered) - sum(len(stretch) for stretch in stretches))
        if left < min(MOST_LEFT, max(LEAST_LEFT, LEAST_LEFT_SHARE * CELL * len(covered))):
            landmarks.retire(wall, keyframe)
            self.settle([wall])
            return True
        opened = [cell for stretch in stretches if CELL * len(stretch) >= LEAST_OPENING for cell in stretch]
        if opened:
            landmarks.open(wall, opened, keyframe)
            self.counts[wall] = {cell: count for cell, count in counts.items() if cell in landmarks.covered[wall]}
        return bool(opened)


def _looked(landmarks: Landmarks, pose: se2.Pose, points: Floats) -> _Look | None:
    """What is seen from a pose of the walls around; None where there are none, or nothing is seen."""
    reach = float(np.hypot(points[:, 0], points[:, 1]).max(initial=0.0))
    walls = landmarks.walls_near(pose, reach, behind=np.inf)
    if not len(walls):
        return None
    rows = landmarks.walls.rows[walls]
    first = np.floor(rows["low"] / CELL).astype(np.int64)
    sizes = np.maximum(1, np.ceil(rows["high"] / CELL).astype(np.int64) - first)
    ends = np.concatenate([[0], np.cumsum(sizes)])
    seen, depth = sight(pose[:2], se2.transform(pose, points).reshape(-1, 2), rows["frame"].copy(), first, ends)
    return _Look(walls, rows, first, ends, seen, depth, pose[:2])


@njit(cache=True)
def sight(eye, points, frames, first, ends):  # type: ignore[no-untyped-def]
    """What sight lines from `eye` (2,) to points (p, 2) show of walls with frames (n, 3), cells as in a look.

    Whether a point lies on a cell; and for each cell the most, over the sight lines that go through it steeply enough,
    of the distance of their nearer end from the wall's line. A cell that is seen is not seen through.
    """
    seen, depth = np.zeros(ends[-1], dtype=np.bool_), np.zeros(ends[-1])
    for wall in range(len(frames)):
        x, y = frames[wall, 0], frames[wall, 1]
        c, s = math.cos(frames[wall, 2]), math.sin(frames[wall, 2])
        ex, ey = c * (eye[0] - x) + s * (eye[1] - y), c * (eye[1] - y) - s * (eye[0] - x)
        start, size = ends[wall], ends[wall + 1] - ends[wall]
        for p in range(len(points)):
            ty = c * (points[p, 1] - y) - s * (points[p, 0] - x)
            near = abs(ty) < SAME
            if not near and (ey * ty > 0.0 or min(abs(ty), abs(ey)) < BEHIND):
                continue
            at = c * (points[p, 0] - x) + s * (points[p, 1] - y)
            if not near:
                if abs(ty - ey) < STEEPEST * math.hypot(at - ex, ty - ey):
                    continue
                at = ex + (at - ex) * ey / (ey - ty)
            cell = int(math.floor(at / CELL)) - first[wall]
            if 0 <= cell < size:
                if near:
                    seen[start + cell] = True
                else:
                    depth[start + cell] = max(depth[start + cell], min(abs(ty), abs(ey)))
        for cell in range(start, start + size):
            if seen[cell]:
                depth[cell] = 0.0
    return seen, depth


def _seen_through(
    look: _Look, landmarks: Landmarks, pose: se2.Pose, pose_covariances: Sequence[Floats]
) -> dict[int, list[int]]:
    """The cells that were seen through, by wall: well within what is known of it, and far enough on either side."""
    through: dict[int, list[int]] = {}
    for row in np.flatnonzero(np.maximum.reduceat(look.depth, look.ends[:-1]) > 0.0).tolist():
        wall = int(look.walls[row])
        covered = landmarks.covered[wall]
        cells = look.cells(row, look.depth > 0.0)
        margin = min(MARGIN, (len(covered) - 1) // 4)
        inside = [covered.issuperset(range(cell - margin, cell + margin + 1)) for cell in cells.tolist()]
        cells = cells[inside]
        if not len(cells):
            continue
        variance = _variance(look.rows[row], CELL * (cells + 0.5), pose, pose_covariances)
        depth = look.depth[look.ends[row] - look.first[row] + cells]
        cells = cells[depth > BEHIND + BEHIND_SIGMAS * np.sqrt(variance)]
        if len(cells):
            through[wall] = cells.tolist()
    return through


def _variance(wall: np.void, along: Floats, pose: se2.Pose, pose_covariances: Sequence[Floats]) -> Floats:
    """(k,): of how far a wall is across itself from the robot at `pose`, at some places along it: as it was when it was
    seen last, and what the robot's own pose has lost in certainty since then; see `local_map_around`."""
    own = wall["covariance"]
    c, s = math.cos(wall["frame"][2]), math.sin(wall["frame"][2])
    lever = wall["frame"][:2] + along[:, None] * np.array([c, s]) - pose[:2]
    jacobian = np.column_stack([np.full(len(along), -s), np.full(len(along), c), lever @ np.array([c, s])])
    lost = pose_covariances[-1] - pose_covariances[wall["last_seen"]]
    drift = np.einsum("ki,ij,kj->k", jacobian, lost, jacobian)
    return np.asarray(own[0, 0] + 2 * along * own[0, 1] + along**2 * own[1, 1] + np.maximum(0.0, drift))


def _believed(look: _Look, through: dict[int, list[int]], ways: Sequence[float]) -> list[int]:
    """The walls of which it is believed that they were seen through.

    The look must see other walls, known no later than the doubted one was seen last, as far as the map may have bent
    since: in every direction, and more of them than it sees through.
    """
    if not through:
        return []
    length, heading = look.seen_length(), look.rows["frame"][:, 2]
    doubled = length * np.exp(2j * heading)
    against = np.array([CELL * len(through.get(wall, ())) for wall in look.walls.tolist()])
    lately = bisect_left(ways, ways[-1] - RECENT_WAY)
    believed = []
    for row in np.flatnonzero(against):
        first, last = look.rows["first_seen"][row], look.rows["last_seen"][row]
        known = look.rows["first_seen"] <= min(last, max(first, lately))
        seen = length[known].sum()
        tie = 0.5 * (seen - abs(doubled[known].sum()))  # the smaller eigenvalue of the sum of length n n'
        if tie >= LEAST_TIE and seen >= MORE_SEEN * against[known].sum():
            believed.append(int(look.walls[row]))
    return believed


def _stretches(gone: Sequence[int], covered: frozenset[int]) -> list[list[int]]:
    """The covered cells in stretches of some that are gone: with what lies between, and up to an end that is near."""
    breaks = np.flatnonzero(np.diff(gone) > GAP + 1)
    stretches = []
    for low, high in zip([gone[0], *np.array(gone)[breaks + 1]], [*np.array(gone)[breaks], gone[-1]], strict=True):
        begin, end = int(low), int(high)
        before = [cell for cell in range(begin - MARGIN - 1, begin) if cell in covered]
        after = [cell for cell in range(end + 1, end + MARGIN + 2) if cell in covered]
        begin = begin - len(before) if len(before) <= MARGIN else begin
        end = end + len(after) if len(after) <= MARGIN else end
        stretches.append([cell for cell in range(begin, end + 1) if cell in covered])
    return stretches
