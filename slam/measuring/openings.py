"""Doors and passages: gaps in walls that the robot drove through, or that both faces of a wall have at one place.

A gap alone may also be a stretch that was not seen. Its ends are known to the length of the cells that the coverage of
a wall consists of, 0.1 m, and have no covariance.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ..geometry.segments import Floats
from .outlines import crossing
from .rooms import Room
from .wall_map import WallMap

# Metres of the narrowest and of the widest opening. Origin: chosen, as MIN_GAP_BETWEEN_PIECES, and the width of a
# corridor that leaves another one; not measured.
MIN_WIDTH, MAX_WIDTH = 0.5, 4.0
# Metres of the widest door. Origin: chosen, as MAX_BRIDGE of outlines, a double door; not measured.
MAX_DOOR = 2.0
# Metres across, and sine of the angle, by which two pieces on one line may differ. Origin: chosen, a skirting board,
# and the thickness of a wall over the width of a door; not measured.
MAX_STEP, MAX_SINE = 0.1, 0.1
# Metres between both faces of one wall. Origin: chosen, an old outer wall; not measured.
MAX_THICKNESS = 0.6
# Share of the wider gap that both faces must have in common. Origin: chosen; not measured.
MIN_SHARED = 0.5
# Metres at each end of a gap that a wall may reach into: the jamb. Origin: chosen, as CORNER_MARGIN of outlines, half.
JAMB_MARGIN = 0.15
# Metres beyond an opening at which it leads into a room. Origin: chosen, less than the smallest room; not measured.
PROBE = 0.3


class OpeningKind(StrEnum):
    """Kinds of openings: a door is at most 2 m wide."""

    DOOR = "door"
    PASSAGE = "passage"


@dataclass(frozen=True, slots=True, eq=False)
class Opening:
    """A door or passage.

    kind    by its width
    number  from 1 for each kind
    ends    (2, 2) in the map, metres: on the wall, or in the middle between its faces
    walls   landmark ids of the walls that have the gap
    rooms   numbers of the rooms that it leads into, at most two; other space beyond it belongs to no closed room
    driven  true if the robot drove through, false if both faces of the wall have the gap
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


@dataclass(frozen=True, slots=True, eq=False)
class _Gap:
    """Gap between two pieces of one face of a wall.

    rows   of the walls before and after it
    ends   (2, 2) in the map, in the direction of the first wall
    thickness  metres to the other face, 0 without one
    driven     true if the path crosses it
    """

    rows: tuple[int, ...]
    ends: Floats
    thickness: float
    driven: bool


def find_openings(wall_map: WallMap, rooms: Sequence[Room]) -> list[Opening]:
    """Return the doors and passages of a map, ordered by wall."""
    counts: Counter[OpeningKind] = Counter()
    openings = []
    for gap in _join_faces(wall_map, _find_gaps(wall_map)):
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


def _join_faces(wall_map: WallMap, gaps: Sequence[_Gap]) -> list[_Gap]:
    """Return the gaps that are openings; those of both faces of a wall are joined.

    Cells at the ends of a gap that are partly wall count as wall, so the wider end of both faces is nearer to the jamb.
    """
    candidates = [
        (shared, i, j)
        for i, first in enumerate(gaps)
        for j, second in enumerate(gaps[:i])
        if (shared := _shared(wall_map, first, second)) >= MIN_SHARED
    ]
    other: dict[int, int] = {}
    for _, i, j in sorted(candidates, reverse=True):
        if i not in other and j not in other:
            other[i], other[j] = j, i
    joined = []
    for k, gap in enumerate(gaps):
        if k not in other:
            joined += [gap] if gap.driven else []
        elif k < other[k]:
            joined.append(_joined(wall_map, gap, gaps[other[k]]))
    return joined


def _shared(wall_map: WallMap, first: _Gap, second: _Gap) -> float:
    """Return the share of the wider of two gaps that both have in common, 0 unless they are in faces of one wall."""
    normal = wall_map.normal(first.rows[0])
    along = np.array([normal[1], -normal[0]])
    behind = float(normal @ (first.ends[0] - second.ends.mean(axis=0)))
    turn = wall_map.normal(second.rows[0])
    if not (0.0 < behind <= MAX_THICKNESS and normal @ turn < 0.0 and abs(along @ turn) <= MAX_SINE):
        return 0.0
    spans = [np.sort(gap.ends @ along) for gap in (first, second)]
    common = min(spans[0][1], spans[1][1]) - max(spans[0][0], spans[1][0])
    return float(common / max(np.ptp(spans[0]), np.ptp(spans[1])))


def _joined(wall_map: WallMap, first: _Gap, second: _Gap) -> _Gap:
    """Return a gap in the middle between two faces."""
    normal = wall_map.normal(first.rows[0])
    along = np.array([normal[1], -normal[0]])
    places = np.concatenate([first.ends, second.ends]) @ along
    depths = [float(gap.ends.mean(axis=0) @ normal) for gap in (first, second)]
    ends = np.outer([places.min(), places.max()], along) + np.mean(depths) * normal
    return _Gap((*first.rows, *second.rows), ends, abs(depths[0] - depths[1]), first.driven or second.driven)


def _rooms_beside(gap: _Gap, rooms: Sequence[Room]) -> tuple[int, ...]:
    """Return the numbers of the rooms on both sides of a gap; of rooms inside one another, the smallest."""
    along = (gap.ends[1] - gap.ends[0]) / np.hypot(*(gap.ends[1] - gap.ends[0]))
    reach = (0.5 * gap.thickness + PROBE) * np.array([-along[1], along[0]])
    found = set()
    for probe in (gap.ends.mean(axis=0) + reach, gap.ends.mean(axis=0) - reach):
        inside = [room.number for room in rooms if room.contains(probe[None])[0]]
        found |= {max(inside)} if inside else set()
    return tuple(sorted(found))
