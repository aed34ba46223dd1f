"""Voting for the pose of a submap in a map, from any start: pairs of walls vote.

Two walls that are not parallel define a frame: its origin is where their lines meet, its x axis runs along the first
one, from which the second one turns left. Because a wall is seen from one side, that frame is unique, and putting the
frame of a submap's pair on that of a map's pair with the same angle determines the motion. The stretches of both walls
must overlap then. Votes are counted in sorted cells instead of a grid, so that memory grows with the votes and not with
the size of the building.
"""

from __future__ import annotations

import math

import numpy as np

from drivers.compiled import compiled

from ..geometry.angles import wrap_angle
from ..geometry.segments import Floats, Integers
from ..geometry.significance import MOST
from ..loop_closure.submap_search import DISTINCT_SHIFT, DISTINCT_TURN
from .map_descriptor import MapDescriptor

# Sine of the least angle between two walls that determine a motion: 30 degrees.
# Origin: chosen, for conditioning; not measured.
MIN_PAIR_SINE = 0.5
# Radians by which the angle between two walls of the submap may differ from that between those of the map.
# Origin: chosen; not measured.
PAIR_ANGLE_TOLERANCE = math.radians(5.0)
# Metres from where the lines of a pair meet to the nearer end of either wall. Origin: chosen; not measured.
MAX_PAIR_DISTANCE = 8.0
# Metres: the heading of a shorter wall is too uncertain to vote. Origin: chosen; not measured.
MIN_VOTING_LENGTH = 0.3
# Longest walls of the submap that vote. Origin: chosen, for speed; not measured.
MAX_VOTING_WALLS = 16
# Share of the shorter of two walls that must overlap with the other. Origin: definition, most of it.
MIN_OVERLAP_SHARE = MOST
# Metres of wall, largest vote of one pair, so that the walls of a corridor do not outvote all others.
# Origin: chosen; not measured.
MAX_PAIR_VOTE = 2.0
# Cells of poses around the full turn; they are as large as poses differ that are the same place. Origin: definition.
HEADING_CELLS = round(2 * math.pi / DISTINCT_TURN)
# Cells with most votes whose neighbourhoods are summed. Origin: chosen, for speed; not measured.
MAX_SUMMED_CELLS = 600
# Offsets (27, 3) of a cell and its neighbours. Origin: definition.
NEIGHBOURHOOD = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
# Columns of a pair table. Origin: definition.
ANGLE, X, Y, HEADING, LOW, HIGH, OTHER_LOW, OTHER_HIGH = range(8)


def build_pair_table(descriptor: MapDescriptor, max_walls: int | None = None) -> Floats:
    """Return a table (p, 8) of the pairs of walls that are not parallel, sorted by the angle between them.

    The columns are the angle, the pair's frame (X, Y, HEADING), and the ends of both walls (LOW, HIGH and OTHER_LOW,
    OTHER_HIGH) in metres along them from where their lines meet. At most the `max_walls` longest walls are used.
    """
    order = np.argsort(-descriptor.half_length, kind="stable")[:max_walls]
    order = order[2 * descriptor.half_length[order] > MIN_VOTING_LENGTH]
    table = _find_pairs(descriptor.frame[order], descriptor.half_length[order])
    return np.asarray(table[np.argsort(table[:, ANGLE], kind="stable")])


def vote_for_poses(submap: MapDescriptor, pairs: Floats, max_poses: int) -> Floats:
    """Return poses (k, 3) of the submap's frame in the map, at most `max_poses`, those with most votes first.

    `pairs` is the pair table of the map.
    """
    own = build_pair_table(submap, MAX_VOTING_WALLS)
    votes = _vote_by_pairs(own, pairs, np.searchsorted(pairs[:, ANGLE], own[:, ANGLE] - PAIR_ANGLE_TOLERANCE))
    if not len(votes):
        return np.zeros((0, 3))
    return _strongest_poses(votes, max_poses)


def _strongest_poses(votes: Floats, max_poses: int) -> Floats:
    """Return the mean poses (k, 3) of the votes (v, 4) in cells that have more votes than all their neighbours.

    Those with most votes in their neighbourhoods are first. The neighbour of such a cell may have as many in its own,
    which contains the cell, but the mean of its few votes is beside the pose.
    """
    origin = votes[:, :2].min(axis=0)
    cells = np.column_stack([(votes[:, :2] - origin) // DISTINCT_SHIFT, votes[:, 2] // DISTINCT_TURN]).astype(np.int64)
    rows = int(cells[:, 1].max()) + 3  # an empty row on either side separates the columns
    keys = _cell_keys(cells, rows)
    order = np.argsort(keys, kind="stable")
    keys, first = np.unique(keys[order], return_index=True)
    weight = votes[order, 3]
    total = np.add.reduceat(weight, first)
    means = np.add.reduceat(votes[order, :3] * weight[:, None], first, axis=0) / total[:, None]
    strongest = np.argsort(-total, kind="stable")[:MAX_SUMMED_CELLS]
    cells = cells[order][first]
    strongest = strongest[_separate_cells(cells[strongest])]
    near = cells[strongest, None] + NEIGHBOURHOOD
    near[..., 2] %= HEADING_CELLS
    wanted = _cell_keys(near, rows)
    at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    support = np.where(keys[at] == wanted, total[at], 0.0).sum(axis=1)
    return np.asarray(means[strongest[np.argsort(-support, kind="stable")[:max_poses]]])


def _cell_keys(cells: Integers, rows: int) -> Integers:
    """Return a unique number for each cell (..., 3)."""
    return ((cells[..., 0] + 1) * rows + cells[..., 1] + 1) * HEADING_CELLS + cells[..., 2]


@compiled
def _separate_cells(cells):  # type: ignore[no-untyped-def]
    """Return the rows of the cells (n, 3) that are no neighbours of an earlier one of these."""
    chosen, count = np.empty(len(cells), np.int64), 0
    for row in range(len(cells)):
        is_near = False
        for other in chosen[:count]:
            turn = abs(cells[row, 2] - cells[other, 2])
            is_near |= (
                abs(cells[row, 0] - cells[other, 0]) <= 1
                and abs(cells[row, 1] - cells[other, 1]) <= 1
                and min(turn, HEADING_CELLS - turn) <= 1
            )
        if not is_near:
            chosen[count] = row
            count += 1
    return chosen[:count]


@compiled
def _find_pairs(frames, halves):  # type: ignore[no-untyped-def]
    """Return the pair table, unsorted."""
    count = 0
    table = np.empty((1024, 8))
    for a in range(len(frames)):
        ca, sa = math.cos(frames[a, 2]), math.sin(frames[a, 2])
        for b in range(len(frames)):
            angle = wrap_angle(frames[b, 2] - frames[a, 2])
            sine = math.sin(angle)
            if sine < MIN_PAIR_SINE:
                continue
            cb, sb = math.cos(frames[b, 2]), math.sin(frames[b, 2])
            dx, dy = frames[b, 0] - frames[a, 0], frames[b, 1] - frames[a, 1]
            along_a = (dx * sb - dy * cb) / sine  # intersection, from the middle of the first wall
            along_b = (dx * sa - dy * ca) / sine
            if max(abs(along_a) - halves[a], abs(along_b) - halves[b]) > MAX_PAIR_DISTANCE:
                continue
            if count == len(table):
                table = _with_twice_the_rows(table)
            row = table[count]
            row[ANGLE], row[HEADING] = angle, frames[a, 2]
            row[X], row[Y] = frames[a, 0] + ca * along_a, frames[a, 1] + sa * along_a
            row[LOW], row[HIGH] = -halves[a] - along_a, halves[a] - along_a
            row[OTHER_LOW], row[OTHER_HIGH] = -halves[b] - along_b, halves[b] - along_b
            count += 1
    return table[:count]


@compiled
def _with_twice_the_rows(table):  # type: ignore[no-untyped-def]
    """Return a copy of a table with as many rows again, which are undefined."""
    larger = np.empty((2 * len(table), table.shape[1]))
    for row in range(len(table)):
        for column in range(table.shape[1]):
            larger[row, column] = table[row, column]
    return larger


@compiled
def _vote_by_pairs(own, pairs, starts):  # type: ignore[no-untyped-def]
    """Return votes (v, 4): position of the submap's origin, heading in [0, 2 pi), and weight in metres of wall.

    own, pairs  pair tables of the submap and of the map
    starts      of each pair of the submap, the first pair of the map whose angle is near enough
    """
    count = 0
    votes = np.empty((4096, 4))
    for i in range(len(own)):
        pair = own[i]
        length, other_length = pair[HIGH] - pair[LOW], pair[OTHER_HIGH] - pair[OTHER_LOW]
        second_weight = other_length**2 / (length**2 + other_length**2)
        dx, dy = -pair[X], -pair[Y]
        for j in range(starts[i], len(pairs)):
            map_pair = pairs[j]
            if map_pair[ANGLE] > pair[ANGLE] + PAIR_ANGLE_TOLERANCE:
                break
            overlap = min(pair[HIGH], map_pair[HIGH]) - max(pair[LOW], map_pair[LOW])
            if overlap < MIN_OVERLAP_SHARE * min(length, map_pair[HIGH] - map_pair[LOW]):
                continue
            other = min(pair[OTHER_HIGH], map_pair[OTHER_HIGH]) - max(pair[OTHER_LOW], map_pair[OTHER_LOW])
            if other < MIN_OVERLAP_SHARE * min(other_length, map_pair[OTHER_HIGH] - map_pair[OTHER_LOW]):
                continue
            turn = map_pair[HEADING] - pair[HEADING] + second_weight * (map_pair[ANGLE] - pair[ANGLE])
            if count == len(votes):
                votes = _with_twice_the_rows(votes)
            c, s = math.cos(turn), math.sin(turn)
            votes[count, 0], votes[count, 1] = map_pair[X] + c * dx - s * dy, map_pair[Y] + s * dx + c * dy
            votes[count, 2], votes[count, 3] = turn % (2 * math.pi), min(MAX_PAIR_VOTE, overlap, other)
            count += 1
    return votes[:count]
