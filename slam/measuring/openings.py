"""Doors and passages: gaps in walls that the robot drove through, or that both faces of a wall have at one place.

A gap alone may also be a stretch that was not seen. Stretches of both faces that were not seen end at different places.
The ends of a gap are known to the length of the cells that the coverage of a wall consists of, 0.1 m, and have no
covariance.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from enum import StrEnum
from itertools import combinations

import numpy as np

from drivers.immutable import immutable

from ..geometry.segments import Floats
from .outlines import CORNER_MARGIN, MAX_BRIDGE, crossing
from .rooms import Room
from .wall_map import WallMap

# Metres of the narrowest and of the widest opening. Origin: chosen, as MIN_GAP_BETWEEN_PIECES, and the width of a
# corridor that leaves another one; not measured.
MIN_WIDTH, MAX_WIDTH = 0.5, 4.0
# Metres of the widest door. Origin: chosen, a double door, as for the outlines of rooms; not measured.
MAX_DOOR = MAX_BRIDGE
# Metres across, and sine of the angle, by which two pieces on one line may differ. Origin: chosen, a skirting board,
# and the thickness of a wall over the width of a door; not measured.
MAX_STEP, MAX_SINE = 0.1, 0.1
# Metres between both faces of one wall. Origin: chosen, an old outer wall; not measured.
MAX_THICKNESS = 0.6
# Metres between the jambs that both faces show if there is an opening. Origin: measured, at most 0.23 m for eleven
# gaps that were driven through (simulated office, Intel, fr079), and more than 0.4 m at one end of two stretches that
# were not seen (Intel).
JAMB_TOLERANCE = 0.25
# Share of the wider gap that both faces must have in common. Origin: chosen; not measured.
MIN_SHARED = 0.5
# Metres at each end of a gap that a wall may reach into: the jamb. Origin: chosen, half of what a wall may reach beyond
# a corner.
JAMB_MARGIN = 0.5 * CORNER_MARGIN
# Metres beyond an opening at which it leads into a room. Origin: chosen, less than the smallest room; not measured.
PROBE = 0.3


class OpeningKind(StrEnum):
    """Kinds of openings: a door is at most 2 m wide."""

    DOOR = "door"
    PASSAGE = "passage"


@immutable
class Opening:
    """A door or passage.

    kind    by its width
    number  from 1 for each kind
    ends    (2, 2) in the map, metres: on the wall, or in the middle between its faces
    walls   landmark ids of the walls that have the gap
    rooms   numbers of the rooms that it leads into, at most two; other space beyond it belongs to no closed room
    driven  true if the robot drove through, false if only both faces of the wall show the gap
    """

    kind: OpeningKind
    number: int
    ends: Floats
    walls: tuple[int, ...]
    rooms: tuple[int, ...]
    driven: bool

    @property
    def name(self) -> str:
        """Kind and number."""
        return f"{self.kind} {self.number}"

    @property
    def width(self) -> float:
        """Metres between the ends."""
        return float(np.hypot(*(self.ends[1] - self.ends[0])))


@immutable
class _Gap:
    """Gap between two pieces of one face of a wall.

    rows       of the walls before and after it
    ends       (2, 2) in the map
    thickness  metres to the other face of the wall, 0 if that has no gap
    driven     true if the path crosses it
    two_faced  true if both faces have it between the same jambs
    """

    rows: tuple[int, ...]
    ends: Floats
    thickness: float
    driven: bool
    two_faced: bool = False


def find_openings(wall_map: WallMap, rooms: Sequence[Room]) -> list[Opening]:
    """Return the doors and passages of a map, ordered by wall."""
    counts: Counter[OpeningKind] = Counter()
    openings = []
    for gap in _join_gaps(wall_map, _find_gaps(wall_map)):
        kind = OpeningKind.DOOR if np.hypot(*(gap.ends[1] - gap.ends[0])) <= MAX_DOOR else OpeningKind.PASSAGE
        counts[kind] += 1
        walls = tuple(int(wall_map.walls.identity[row]) for row in dict.fromkeys(gap.rows))
        openings.append(Opening(kind, counts[kind], gap.ends, walls, _rooms_beside(gap, rooms), gap.driven))
    return openings


def _find_gaps(wall_map: WallMap) -> list[_Gap]:
    """Return the gaps between successive pieces on one line that no other wall crosses."""
    pieces, rows = wall_map.walls.piece_points()
    gaps = []
    for k, row in enumerate(rows.tolist()):
        end = pieces[k, 1]
        heading = wall_map.walls.frame[rows, 2] - wall_map.walls.frame[row, 2]
        direction = np.array([np.cos(wall_map.walls.frame[row, 2]), np.sin(wall_map.walls.frame[row, 2])])
        low, high = (pieces - end).transpose(1, 0, 2) @ direction
        across = np.abs((pieces[:, 0] - end) @ wall_map.normal(row))
        in_line = (np.abs(np.sin(heading)) <= MAX_SINE) & (np.cos(heading) > 0.0) & (across <= MAX_STEP)
        ahead = np.flatnonzero(in_line & (high > MIN_WIDTH) & (np.arange(len(rows)) != k))
        if not len(ahead):
            continue
        after = int(ahead[low[ahead].argmin()])
        ends = np.stack([end, pieces[after, 0]])
        if MIN_WIDTH <= low[after] <= MAX_WIDTH and not _is_crossed(ends, pieces):
            driven = bool(crossing(ends[0], ends[1], wall_map.path[:-1], wall_map.path[1:]).any())
            gaps.append(_Gap((row, int(rows[after])), ends, 0.0, driven))
    return gaps


def _is_crossed(ends: Floats, pieces: Floats) -> bool:
    """Return True if a piece of a wall crosses a gap, other than at a jamb."""
    margin = JAMB_MARGIN * (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
    return bool(crossing(ends[0] + margin, ends[1] - margin, pieces[:, 0], pieces[:, 1]).any())


def _join_gaps(wall_map: WallMap, gaps: Sequence[_Gap]) -> list[_Gap]:
    """Return the gaps that are openings; those of both faces of a wall, or of two landmarks on one face, are joined."""
    shared = np.array([[_shared(wall_map, first, second) for second in gaps] for first in gaps])
    from scipy.sparse.csgraph import connected_components  # only here: most maps are not measured

    count, group = connected_components(shared.reshape(len(gaps), len(gaps)) >= MIN_SHARED, directed=False)
    groups = [[gap for gap, number in zip(gaps, group, strict=True) if number == k] for k in range(count)]
    joined = [_joined(wall_map, members) for members in groups]
    return [gap for gap in joined if gap.driven or gap.two_faced]


def _shared(wall_map: WallMap, first: _Gap, second: _Gap) -> float:
    """Return the share of the wider of two gaps that both have in common, 0 unless they are in one wall."""
    normal, other = wall_map.normal(first.rows[0]), wall_map.normal(second.rows[0])
    along = np.array([normal[1], -normal[0]])
    behind = float(normal @ (first.ends.mean(axis=0) - second.ends.mean(axis=0)))
    thickest = MAX_THICKNESS if normal @ other < 0.0 else MAX_STEP
    if not (-MAX_STEP <= behind <= thickest and abs(along @ other) <= MAX_SINE):
        return 0.0
    spans = [np.sort(gap.ends @ along) for gap in (first, second)]
    common = min(spans[0][1], spans[1][1]) - max(spans[0][0], spans[1][0])
    return float(common / max(np.ptp(spans[0]), np.ptp(spans[1])))


def _joined(wall_map: WallMap, members: Sequence[_Gap]) -> _Gap:
    """Return one gap for several in one wall, in the middle between its faces.

    Cells at the ends of a gap that are partly wall count as wall, so the outermost ends are nearest to the jambs.
    """
    if len(members) == 1:
        return members[0]
    normal = wall_map.normal(members[0].rows[0])
    along = np.array([normal[1], -normal[0]])
    places = np.concatenate([gap.ends for gap in members]) @ along
    depths = [float(gap.ends.mean(axis=0) @ normal) for gap in members]
    ends = np.outer([places.min(), places.max()], along) + 0.5 * (min(depths) + max(depths)) * normal
    sides = [np.sign(wall_map.normal(gap.rows[0]) @ normal) for gap in members]
    spans = [np.sort(gap.ends @ along) for gap in members]
    two_faced = any(
        sides[i] != sides[j] and np.abs(spans[i] - spans[j]).max() <= JAMB_TOLERANCE
        for i, j in combinations(range(len(members)), 2)
    )
    rows = tuple(row for gap in members for row in gap.rows)
    thickness = max(depths) - min(depths) if len(set(sides)) > 1 else 0.0
    return _Gap(rows, ends, thickness, any(gap.driven for gap in members), two_faced)


def _rooms_beside(gap: _Gap, rooms: Sequence[Room]) -> tuple[int, ...]:
    """Return the numbers of the rooms on both sides of a gap; of rooms inside one another, the smallest."""
    along = (gap.ends[1] - gap.ends[0]) / np.hypot(*(gap.ends[1] - gap.ends[0]))
    reach = (0.5 * gap.thickness + PROBE) * np.array([-along[1], along[0]])
    found = set()
    for probe in (gap.ends.mean(axis=0) + reach, gap.ends.mean(axis=0) - reach):
        inside = [room.number for room in rooms if room.contains(probe[None])[0]]
        found |= {max(inside)} if inside else set()
    return tuple(sorted(found))
