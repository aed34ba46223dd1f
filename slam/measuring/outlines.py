"""Outlines of rooms: walls followed from corner to corner, with the room on their left.

A wall is seen from the left of its frame, so a robot in a room sees the walls around it in counter-clockwise order. A
wall is divided at the corners of the map, and where another one runs into the side that it is seen from: the walls of
two rooms may be on one line. Where furniture hides a corner, or a door is open, the outline is continued along the
lines of the walls: of all ways to connect the pieces, that with the least length that was not seen is chosen (linear
assignment, Kuhn 1955). A piece may also stand alone, as an open door leaf does: then its back was not seen, which is as
long as the piece. Such a bridge crosses no wall, except at a corner of the map, and around a corner the path of the
robot only if all that was not seen of it is in one wall: a door beside the corner. If the lines do not meet between two
ends that are near each other, the outline steps from one to the other: at an open door leaf, for example.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.immutable import immutable
from features.corner_angle import MIN_SINE

from ..geometry.segments import Floats, Integers
from .wall_map import WallMap

# Metres of an outline that may be unobserved between two walls. Origin: chosen, a double door, or a cupboard in a
# corner; not measured.
MAX_BRIDGE = 2.0
# Metres by which a wall may reach beyond a corner, or end before it. Origin: chosen, three cells of a wall's coverage.
CORNER_MARGIN = 0.3
# Metres of the longest step between two walls whose lines do not meet there. Origin: chosen, the depth of furniture
# and the distance of an open door leaf from the wall beside it; not measured.
MAX_STEP = 0.6
# Metres added to the length of a step, so that walls are rather continued to the corner where they meet. Also added
# where an outline goes on along a wall that another one meets. Origin: chosen, as CORNER_MARGIN; not measured.
STEP_COST = CORNER_MARGIN
# Sine of the least angle at which one wall divides another one. Origin: chosen, 30 degrees; not measured.
MIN_JUNCTION_SINE = 0.5
# Metres between two places at which a wall is divided. Origin: geometry, half a cell of a wall's coverage; less
# than the thickness of a wall between two rooms.
MIN_CUT_SPACING = 0.05
# Metres between two ends at the same place. Origin: numerical, above rounding and below what any scan can tell apart.
SAME_PLACE = 1e-6


@immutable
class Edges:
    """n observed stretches of walls, none of which continues through a corner.

    wall  (n,) rows of the walls
    span  (n, 2) begin and end, metres along the wall from its frame
    ends  (n, 2, 2) the same as points in the map
    """

    wall: Integers
    span: Floats
    ends: Floats

    def __len__(self) -> int:
        return len(self.wall)


class Stretch(NamedTuple):
    """Stretch of a wall (row) in an outline: where its observed part begins and ends along the wall, metres.

    stepped  True if the outline goes straight from the end of the stretch before to the begin of this one
    """

    wall: int
    low: float
    high: float
    stepped: bool = False


def find_outlines(wall_map: WallMap) -> list[list[Stretch]]:
    """Return all closed outlines, as stretches in their order; one that continues beyond a door is one stretch."""
    edges = wall_edges(wall_map)
    following, stepped = _follow(wall_map, edges)
    outlines, done = [], np.zeros(len(edges), dtype=bool)
    for start in range(len(edges)):
        chain: list[int] = []
        edge = start
        while edge >= 0 and not done[edge]:
            done[edge] = True
            chain.append(edge)
            edge = int(following[edge])
        if chain and edge == start:
            ends = [(float(low), float(high)) for low, high in edges.span[chain]]
            walls = edges.wall[chain].tolist()
            steps = stepped[chain].tolist()
            outlines.append(
                _joined([Stretch(wall, *span, step) for wall, span, step in zip(walls, ends, steps, strict=True)])
            )
    return outlines


def _joined(chain: list[Stretch]) -> list[Stretch]:
    """Return a closed chain with successive stretches of one wall joined."""
    first = next((k for k, stretch in enumerate(chain) if stretch.wall != chain[k - 1].wall), 0)
    joined: list[Stretch] = []
    for stretch in [*chain[first:], *chain[:first]]:
        if joined and joined[-1].wall == stretch.wall:
            joined[-1] = joined[-1]._replace(high=stretch.high)
        else:
            joined.append(stretch)
    return joined


def wall_edges(wall_map: WallMap) -> Edges:
    """Return the observed pieces of the walls, cut at the corners, and where other walls run into them."""
    rows: list[int] = []
    spans: list[tuple[float, float]] = []
    cuts = _corner_places(wall_map)
    for row, along in _junctions(wall_map):
        if all(abs(along - other) > MIN_CUT_SPACING for other in cuts.setdefault(row, [])):
            cuts[row].append(along)
    for row, pieces in enumerate(wall_map.walls.pieces):
        for low, high in pieces.tolist():
            inside = sorted(c for c in cuts.get(row, []) if low + CORNER_MARGIN < c < high - CORNER_MARGIN)
            stops = [low, *inside, high]
            rows += [row] * (len(stops) - 1)
            spans += pairwise(stops)
    ends = [[wall_map.point(row, along) for along in span] for row, span in zip(rows, spans, strict=True)]
    return Edges(np.array(rows, dtype=np.int64), np.array(spans).reshape(-1, 2), np.array(ends).reshape(-1, 2, 2))


def _known_corners(wall_map: WallMap) -> list[tuple[int, int, Floats]]:
    """Return the rows of both walls, and the position, of each corner whose walls are in the map."""
    row_of = {int(identity): row for row, identity in enumerate(wall_map.walls.identity)}
    corners = zip(wall_map.corners.walls.tolist(), wall_map.corners.position, strict=True)
    return [(row_of[a], row_of[b], place) for (a, b), place in corners if a in row_of and b in row_of and a != b]


def _corner_places(wall_map: WallMap) -> dict[int, list[float]]:
    """Return for each wall with corners where they are along it, metres."""
    places: dict[int, list[float]] = {}
    for first, second, position in _known_corners(wall_map):
        for row in (first, second):
            places.setdefault(row, []).append(wall_map.along(row, position))
    return places


def _junctions(wall_map: WallMap) -> list[tuple[int, float]]:
    """Return the walls, and the metres along them, where a piece of another wall ends at the side they are seen from.

    The end may be farther away by the tolerance of a corner, and the junction must be on an observed piece.
    """
    points, rows = wall_map.walls.piece_points()
    heading = wall_map.walls.frame[rows, 2]
    along = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    found = set()
    for k in range(len(rows)):
        for end, outward in ((points[k, 0], -along[k]), (points[k, 1], along[k])):
            against = -(normal @ outward)
            steep = np.where(against > MIN_JUNCTION_SINE, against, np.nan)  # comparisons with NaN are false
            reach = np.einsum("ij,ij->i", end - points[:, 0], normal) / steep
            place = np.einsum("ij,ij->i", end + reach[:, None] * outward - points[:, 0], along)
            length = np.einsum("ij,ij->i", points[:, 1] - points[:, 0], along)
            near = (reach >= -CORNER_MARGIN) & (reach <= 2.0 * CORNER_MARGIN)
            for other in np.flatnonzero(near & (place > CORNER_MARGIN) & (place < length - CORNER_MARGIN)).tolist():
                row = int(rows[other])
                found.add((row, wall_map.along(row, points[other, 0]) + float(place[other])))
    return sorted(found)


def _follow(wall_map: WallMap, edges: Edges) -> tuple[Integers, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """Return for each edge (n,) the one that follows it, -1 if unknown, and whether a step leads to it (n,)."""
    cost = np.full((len(edges), 2 * len(edges)), MAX_BRIDGE)  # the last columns: nothing follows
    steps = np.zeros((len(edges), len(edges)), dtype=bool)
    apart = np.hypot(*(edges.ends[:, None, 1] - edges.ends[None, :, 0]).transpose(2, 0, 1))
    for before, after in np.argwhere(apart <= MAX_BRIDGE).tolist():
        bridge, step = (of(wall_map, edges, before, after) for of in (_bridge_cost, _step_cost))
        cost[before, after], steps[before, after] = min(bridge, step, 2.0 * MAX_BRIDGE), step < bridge
    for before, after, unseen in _corner_links(wall_map, edges):
        if unseen < cost[before, after]:
            cost[before, after], steps[before, after] = unseen, False
    alone = np.arange(len(edges))
    cost[alone, alone] = np.minimum(edges.span[:, 1] - edges.span[:, 0], MAX_BRIDGE)
    from scipy.optimize import linear_sum_assignment  # only here: most runs measure no rooms

    _, columns = linear_sum_assignment(cost)
    rows = np.arange(len(edges))
    known = (columns < len(edges)) & (cost[rows, columns] < MAX_BRIDGE)
    following = np.where(known, columns, -1)
    stepped = np.zeros(len(edges), dtype=bool)
    stepped[following[known]] = steps[rows, columns % len(edges)][known]
    return following, stepped


def _corner_links(wall_map: WallMap, edges: Edges) -> Iterator[tuple[int, int, float]]:
    """Yield the edges before and after each corner that was seen, and the metres between them that were not."""
    for first, second, position in _known_corners(wall_map):
        ends = wall_map.along(first, position), wall_map.along(second, position)
        before, after = _nearest(edges, first, 1, ends[0]), _nearest(edges, second, 0, ends[1])
        if min(before, after) >= 0:
            unseen = abs(ends[0] - float(edges.span[before, 1])) + abs(ends[1] - float(edges.span[after, 0]))
            yield before, after, unseen


def _nearest(edges: Edges, wall: int, side: int, along: float) -> int:
    """Return the edge of a wall that begins (side 0) or ends (1) nearest to a place along it; -1 without one."""
    rows = np.flatnonzero(edges.wall == wall)
    distance = np.abs(edges.span[rows, side] - along)
    return int(rows[distance.argmin()]) if len(rows) and distance.min() < 2.0 * CORNER_MARGIN else -1


def _bridge_cost(wall_map: WallMap, edges: Edges, before: int, after: int) -> float:
    """Return the metres that were not seen if one edge follows another, infinite if it cannot."""
    first, second = int(edges.wall[before]), int(edges.wall[after])
    end, start = edges.ends[before, 1], edges.ends[after, 0]
    turn = float(wall_map.walls.frame[second, 2] - wall_map.walls.frame[first, 2])
    if abs(np.sin(turn)) <= MIN_SINE:
        gap = wall_map.along(first, start) - float(edges.span[before, 1])
        cost = abs(gap) + abs(float(wall_map.normal(first) @ (start - end)))
        if first == second and gap <= SAME_PLACE:  # divided where another wall meets it
            cost += STEP_COST
        possible = np.cos(turn) > 0.0 and gap >= -CORNER_MARGIN and cost <= MAX_BRIDGE
        return cost if possible and not _crosses(edges, np.stack([end, start]), (before, after)) else np.inf
    if np.hypot(*(start - end)) > MAX_BRIDGE:
        return np.inf
    corner, _ = wall_map.intersection(first, second)
    beyond = wall_map.along(first, corner) - float(edges.span[before, 1])
    ahead = float(edges.span[after, 0]) - wall_map.along(second, corner)
    cost = abs(beyond) + abs(ahead)
    if min(beyond, ahead) < -CORNER_MARGIN or cost > MAX_BRIDGE:
        return np.inf
    bridge = np.stack([end if beyond > 0.0 else corner, corner, start if ahead > 0.0 else corner])
    is_door = min(beyond, ahead) <= CORNER_MARGIN
    if _crosses(edges, bridge, (before, after)) or (not is_door and _meets(bridge, wall_map.path)):
        return np.inf
    return cost


def _step_cost(wall_map: WallMap, edges: Edges, before: int, after: int) -> float:
    """Return the cost, metres, of a straight step from one edge to another one, infinite if there can be none.

    A step turns by less than a right angle: more would lead around the end of a wall, to its other side.
    """
    step = np.stack([edges.ends[before, 1], edges.ends[after, 0]])
    length = float(np.hypot(*(step[1] - step[0])))
    turn = wall_map.walls.frame[edges.wall[after], 2] - wall_map.walls.frame[edges.wall[before], 2]
    if before == after or length > MAX_STEP or np.cos(turn) < 0.0:
        return np.inf
    if _crosses(edges, step, (before, after)) or _meets(step, wall_map.path):
        return np.inf
    return length + STEP_COST


def _crosses(edges: Edges, bridge: Floats, without: tuple[int, int]) -> bool:
    """Return True if a polyline (k, 2) crosses an edge of other walls than those of two edges.

    Edges of these walls are on one line with parts of the polyline: whether they cross it would be up to rounding.
    """
    others = edges.ends[~np.isin(edges.wall, edges.wall[list(without)])]
    return any(crossing(a, b, others[:, 0], others[:, 1]).any() for a, b in pairwise(bridge))


def _meets(bridge: Floats, path: Floats) -> bool:
    """Return True if a polyline (k, 2) crosses another one (m, 2)."""
    return any(crossing(a, b, path[:-1], path[1:]).any() for a, b in pairwise(bridge))


def crossing(a: Floats, b: Floats, starts: Floats, ends: Floats) -> NDArray[np.bool_]:
    """Return (...,) which of the segments from `starts` (..., 2) to `ends` cross those from `a` (..., 2) to `b`."""
    apart = _side(a, b, starts) * _side(a, b, ends) < 0.0
    return np.asarray(apart & (_side(starts, ends, a) * _side(starts, ends, b) < 0.0))


def _side(p: Floats, q: Floats, r: Floats) -> Floats:
    """Return (...,) numbers that are positive if r (..., 2) is to the left of the line from p to q."""
    return np.asarray(
        (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])
    )
