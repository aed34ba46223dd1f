"""Removal of walls that are no longer there: free-space evidence of the scans that see through them.

For each cell of a wall, the scans that see through it are counted; a scan that sees something there takes back three of
them. So glass stays, which some scans see and some do not. A scan that may be wrong about its own pose does not count.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence, Set

import numpy as np

from drivers import se2

from ..geometry.segments import Floats, Integers
from ..geometry.significance import SUPPORT_RATIO
from ..geometry.surroundings import INDOOR_RANGE, ROOM_SIZE
from .landmarks import Landmarks
from .sight_lines import WallsInView, cells_seen_through, walls_in_view
from .wall_cells import END_ERROR_CELLS, MIN_GAP_BETWEEN_PIECES, WALL_CELL

# Metres of driving between two scans that count: an error of one scan is repeated at the same place.
# Origin: chosen, less than the distance between keyframes; not measured.
MIN_STEP = 0.2
# Scans seeing through a cell that one scan seeing something there takes back: glass that more than a quarter of the
# scans see stays. Origin: definition.
SEEN_WEIGHT = round(SUPPORT_RATIO)
# Scans that must have seen through a cell of a well-observed wall; fewer if the wall has fewer observations than that.
# Origin: chosen; not measured.
MAX_REQUIRED_SCANS = 6
# Metres of the narrowest opening: a door, rather than a hole between two beams. Origin: definition, so that the rest of
# the wall is in pieces.
MIN_OPENING = MIN_GAP_BETWEEN_PIECES
# Metres of driving within which the map does not bend. Origin: definition, scans along it show common surfaces.
RIGID_DISTANCE = INDOOR_RANGE
# A robot that has drifted, or is elsewhere, sees through many walls. So a scan must also see other walls, first
# observed no later than the wall in question was last observed (see `_supported`).
# Metres of them in every direction. Origin: chosen; not measured.
MIN_SUPPORT = 1.0
# Ratio of their length to the length that the scan sees through. Origin: definition.
MIN_SUPPORT_RATIO = SUPPORT_RATIO
# Metres of driving for which no scan counts after `suspend`: the next search for loops is within it.
# Origin: definition, one and a half intervals of that search, each of a third of a submap.
SUSPENSION_DISTANCE = 0.5 * ROOM_SIZE


class FreeSpaceEvidence:
    """Evidence against walls: for each cell, how many scans have seen through it, less those that saw it.

    counts  by wall id and cell, all positive
    """

    def __init__(self, counts: Mapping[int, Mapping[int, int]] | None = None) -> None:
        self.counts: dict[int, dict[int, int]] = {wall: dict(cells) for wall, cells in (counts or {}).items()}
        self._last_position: Floats | None = None
        self._suspended_at = -np.inf

    def __deepcopy__(self, memo: dict[int, object]) -> FreeSpaceEvidence:
        other = FreeSpaceEvidence(self.counts)
        other._last_position, other._suspended_at = self._last_position, self._suspended_at
        return other

    def clear(self) -> None:
        """Discard all counts, as after a loop closure: they were made with another map."""
        self.counts, self._last_position = {}, None

    def suspend(self, travelled: float) -> None:
        """Discard all counts, and count nothing for SUSPENSION_DISTANCE metres of driving from `travelled` metres on.

        For use if another place in the map explains the observations better than the present pose: earlier and coming
        scans may be wrong about their pose.
        """
        self.clear()
        self._suspended_at = travelled

    def discard(self, walls: Sequence[int]) -> None:
        """Discard the counts of some walls."""
        for wall in walls:
            self.counts.pop(wall, None)

    def update(
        self,
        landmarks: Landmarks,
        pose: se2.Pose,
        points: Floats,
        travelled: Sequence[float],
        pose_covariances: Floats,
    ) -> bool:
        """Add the evidence of a scan, and remove or open the walls with sufficient evidence. Return True if any.

        points            (p, 2) of the scan, in the frame of its pose
        travelled         metres driven up to each keyframe
        pose_covariances  (k, 3, 3) of all keyframes, in the map's axes
        """
        counted = self.count(landmarks, pose, points, travelled, pose_covariances)
        changed = [self._remove_or_open(landmarks, wall, len(travelled) - 1) for wall in counted]
        return any(changed)

    def count(
        self,
        landmarks: Landmarks,
        pose: se2.Pose,
        points: Floats,
        travelled: Sequence[float],
        pose_covariances: Floats,
    ) -> list[int]:
        """Add the evidence of a scan, with arguments as for `update`. Return the walls that it sees through.

        They are removed by the next `update` with a scan that sees through them, if the evidence suffices.
        """
        if travelled[-1] - self._suspended_at < SUSPENSION_DISTANCE:
            return []
        if self._last_position is not None and np.hypot(*(pose[:2] - self._last_position)) < MIN_STEP:
            return []
        self._last_position = pose[:2].copy()
        view = walls_in_view(landmarks, pose, np.ascontiguousarray(points))
        for row, wall in enumerate(view.walls.tolist()):
            if wall in self.counts and view.length[row]:
                self._count_seen(wall, view.cells(row, view.seen))
        through = cells_seen_through(view, landmarks, pose, pose_covariances)
        walls = []
        for row in _supported(view, through, travelled):
            walls.append(int(view.walls[row]))
            counts = self.counts.setdefault(walls[-1], {})
            for cell in through[row]:
                counts[cell] = counts.get(cell, 0) + 1
        return walls

    def _count_seen(self, wall: int, cells: Integers) -> None:
        """Reduce the counts of cells on which points were seen."""
        counts = self.counts[wall]
        for cell in counts.keys() & set(cells.tolist()):
            counts[cell] -= SEEN_WEIGHT
            if counts[cell] <= 0:
                del counts[cell]
        if not counts:
            del self.counts[wall]

    def _remove_or_open(self, landmarks: Landmarks, wall: int, keyframe: int) -> bool:
        """Remove a wall, or open a stretch of it, if there is enough evidence. Return True if so."""
        observations = int(landmarks.walls.rows["observations"][wall])
        required = min(MAX_REQUIRED_SCANS, observations + 1)
        counts, covered = self.counts[wall], landmarks.covered[wall]
        gone = {cell for cell, count in counts.items() if count >= required}
        if not gone:
            return False
        opened = landmarks.opened_cells(wall)  # an opening may become wider
        stretches = _stretches(gone | opened, covered | opened)
        remaining = WALL_CELL * len(covered - frozenset(cell for stretch in stretches for cell in stretch))
        wide = [stretch for stretch in stretches if WALL_CELL * len(stretch) >= MIN_OPENING]
        opening = covered.intersection(cell for stretch in wide for cell in stretch)
        nothing_left = remaining < MIN_OPENING  # a piece as narrow as that is no wall
        if nothing_left or (opening and observations == 1):  # a single observation, partly wrong, was no wall
            landmarks.remove_wall(wall, keyframe)
            self.discard([wall])
        elif opening:
            landmarks.open_wall(wall, opening, keyframe)
            self.counts[wall] = {cell: count for cell, count in counts.items() if cell not in opening}
        return bool(nothing_left or opening)


def _supported(view: WallsInView, through: dict[int, list[int]], travelled: Sequence[float]) -> list[int]:
    """Return the rows of the walls seen through for which other walls confirm the robot's pose.

    These are walls first observed before the wall in question was last observed, and either before it was first
    observed or more than RIGID_DISTANCE metres of driving ago. With their seen lengths l and normals n, the smaller
    eigenvalue of the sum of l n n' must reach MIN_SUPPORT, and the sum of l MIN_SUPPORT_RATIO times the length that the
    scan sees through.
    """
    if not through:
        return []
    against = np.zeros(len(view.walls))
    against[list(through)] = [WALL_CELL * len(cells) for cells in through.values()]
    recent = bisect_left(travelled, travelled[-1] - RIGID_DISTANCE)
    rows = view.rows
    doubled = view.length * np.exp(2j * rows["frame"][:, 2])
    supported = []
    for row in through:
        older = rows["first_seen"] <= min(rows["last_seen"][row], max(rows["first_seen"][row], recent))
        seen = view.length[older].sum()
        smaller_eigenvalue = 0.5 * (seen - abs(doubled[older].sum()))
        if smaller_eigenvalue >= MIN_SUPPORT and seen >= MIN_SUPPORT_RATIO * against[older].sum():
            supported.append(row)
    return supported


def _stretches(gone: Set[int], known: Set[int]) -> list[list[int]]:
    """Return the known cells in stretches of cells that are gone, with gaps closed and near ends of the wall included.

    A gap has at most END_ERROR_CELLS cells; an end of the wall is near if at most END_ERROR_CELLS cells remain there.
    """
    ordered = np.sort(np.fromiter(gone, dtype=np.int64, count=len(gone)))
    stretches = []
    for part in np.split(ordered, np.flatnonzero(np.diff(ordered) > END_ERROR_CELLS + 1) + 1):
        low, high = int(part[0]), int(part[-1])
        before = [cell for cell in range(low - END_ERROR_CELLS - 1, low) if cell in known]
        after = [cell for cell in range(high + 1, high + END_ERROR_CELLS + 2) if cell in known]
        begin = low - END_ERROR_CELLS if len(before) <= END_ERROR_CELLS else low
        end = high + END_ERROR_CELLS if len(after) <= END_ERROR_CELLS else high
        stretches.append([cell for cell in range(begin, end + 1) if cell in known])
    return stretches
