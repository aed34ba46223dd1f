"""Where a fragment may lie in a map, of any place and heading: pairs of walls vote.

Two walls that are not parallel have a frame of their own: its origin where their lines meet, its x along the first one,
which is the one that the second turns left from. Because walls are seen from one side, that frame is unique, and laying
the frame of a fragment's pair on that of a map's pair with the same angle fixes the motion. The stretches of the two
walls must then lie on each other. A corner is such a frame as well. Motions are counted in cells that are kept sorted,
not in a grid, so that memory follows the votes, not the size of the building.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ..geometry.angles import turn_of
from ..geometry.segments import Floats, Integers
from .map_descriptor import MapDescriptor

LEAST_SINE = 0.5  # of the angle between two walls that fix a motion
SAME_ANGLE = math.radians(5.0)  # by which the angle between two walls may differ from that between those of the map
FARTHEST = 8.0  # metres from where the lines of a pair meet to the nearer end of either wall
SHORTEST = 0.3  # metres: the heading of shorter walls is too uncertain to propose motions
LONGEST = 16  # walls of the fragment that propose motions
LEAST_SHARE = 0.5  # of the shorter of two walls that must lie on the other
MOST_VOTE = 2.0  # metres of wall that one pair speaks for, at most: a corridor's walls must not outvote everything
CORNER_VOTE = 1.0  # the same of a corner
CORNER_TURN = math.radians(15.0)  # by which the headings of two corners that are one may differ
CELL, CELL_TURN = 0.5, math.radians(6.0)  # metres and radians of the cells of motions
HEADINGS = round(2 * math.pi / CELL_TURN)
STRONGEST = 600  # cells whose surroundings are looked at
AROUND = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)  # a cell, its neighbours
ANGLE, X, Y, HEADING, LOW, HIGH, OTHER_LOW, OTHER_HIGH = range(8)  # columns of a table of pairs


def pair_table(scene: MapDescriptor, longest: int | None = None) -> Floats:
    """(p, 8): a row for each pair of walls that are not parallel, by the angle between them; of the longest walls only,
    if wanted. LOW, HIGH and OTHER_LOW, OTHER_HIGH are the walls' ends, metres along each from where their lines meet.
    """
    order = np.argsort(-scene.half_length, kind="stable")[:longest]
    order = order[2 * scene.half_length[order] > SHORTEST]
    table = _pairs(scene.frame[order], scene.half_length[order])
    return np.asarray(table[np.argsort(table[:, ANGLE], kind="stable")])


def vote(fragment: MapDescriptor, scene: MapDescriptor, pairs: Floats, most: int) -> Floats:
    """(k, 3): where the fragment's frame may lie in the map, at most `most` poses, those with most votes first.

    `pairs` is the table of the map.
    """
    own = pair_table(fragment, LONGEST)
    found = _pair_votes(own, pairs)
    corners = _corner_votes(fragment.corners, fragment.headings, scene.corners, scene.headings)
    votes = np.concatenate([found, corners])
    if not len(votes):
        return np.zeros((0, 3))
    return _strongest(votes, most)


def _strongest(votes: Floats, most: int) -> Floats:
    """(k, 3): the means of the votes (v, 4) in the cells with most votes in and around them."""
    origin = votes[:, :2].min(axis=0)
    cells = np.column_stack([(votes[:, :2] - origin) // CELL, votes[:, 2] // CELL_TURN]).astype(np.int64)
    rows = int(cells[:, 1].max()) + 3  # with an empty row on either side, so that neighbours are not mistaken
    keys = _key(cells, rows)
    order = np.argsort(keys, kind="stable")
    keys, first = np.unique(keys[order], return_index=True)
    weight = votes[order, 3]
    total = np.add.reduceat(weight, first)
    means = np.add.reduceat(votes[order, :3] * weight[:, None], first, axis=0) / total[:, None]
    strongest = np.argsort(-total, kind="stable")[:STRONGEST]
    cells = cells[order][first][strongest]
    near = cells[:, None] + AROUND
    near[..., 2] %= HEADINGS
    wanted = _key(near, rows)
    at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    support = np.where(keys[at] == wanted, total[at], 0.0).sum(axis=1)
    return np.asarray(means[strongest[_apart(cells, np.argsort(-support, kind="stable"), most)]])


def _key(cells: Integers, rows: int) -> Integers:
    """One number for each cell (..., 3)."""
    return ((cells[..., 0] + 1) * rows + cells[..., 1] + 1) * HEADINGS + cells[..., 2]


def _apart(cells: Integers, order: Integers, most: int) -> Integers:
    """The first rows in `order` whose cells are no neighbours."""
    chosen: list[int] = []
    for row in order:
        difference = np.abs(cells[chosen] - cells[row])
        difference[:, 2] = np.minimum(difference[:, 2], HEADINGS - difference[:, 2])
        if not (difference <= 1).all(axis=1).any():
            chosen.append(int(row))
            if len(chosen) == most:
                break
    return np.array(chosen, dtype=np.int64)


@njit(cache=True)
def _pairs(frames, halves):  # type: ignore[no-untyped-def]
    """The table of pairs, unsorted."""
    count = 0
    table = np.empty((1024, 8))
    for a in range(len(frames)):
        ca, sa = math.cos(frames[a, 2]), math.sin(frames[a, 2])
        for b in range(len(frames)):
            angle = turn_of(frames[b, 2] - frames[a, 2])
            sine = math.sin(angle)
            if sine < LEAST_SINE:
                continue
            cb, sb = math.cos(frames[b, 2]), math.sin(frames[b, 2])
            dx, dy = frames[b, 0] - frames[a, 0], frames[b, 1] - frames[a, 1]
            along_a = (dx * sb - dy * cb) / sine  # of the meeting point, from the middle of the first wall
            along_b = (dx * sa - dy * ca) / sine
            if max(abs(along_a) - halves[a], abs(along_b) - halves[b]) > FARTHEST:
                continue
            if count == len(table):
                larger = np.empty((2 * count, 8))
                larger[:count] = table
                table = larger
            row = table[count]
            row[ANGLE], row[HEADING] = angle, frames[a, 2]
            row[X], row[Y] = frames[a, 0] + ca * along_a, frames[a, 1] + sa * along_a
            row[LOW], row[HIGH] = -halves[a] - along_a, halves[a] - along_a
            row[OTHER_LOW], row[OTHER_HIGH] = -halves[b] - along_b, halves[b] - along_b
            count += 1
    return table[:count]


@njit(cache=True)
def _pair_votes(own, pairs):  # type: ignore[no-untyped-def]
    """(v, 4): where the origin comes to lie, the turn in [0, 2 pi), and metres of wall."""
    count = 0
    votes = np.empty((4096, 4))
    for i in range(len(own)):
        mine = own[i]
        length, other_length = mine[HIGH] - mine[LOW], mine[OTHER_HIGH] - mine[OTHER_LOW]
        trust = other_length**2 / (length**2 + other_length**2)
        dx, dy = -mine[X], -mine[Y]
        start = np.searchsorted(pairs[:, ANGLE], mine[ANGLE] - SAME_ANGLE)
        for j in range(start, len(pairs)):
            yours = pairs[j]
            if yours[ANGLE] > mine[ANGLE] + SAME_ANGLE:
                break
            overlap = min(mine[HIGH], yours[HIGH]) - max(mine[LOW], yours[LOW])
            if overlap < LEAST_SHARE * min(length, yours[HIGH] - yours[LOW]):
                continue
            other = min(mine[OTHER_HIGH], yours[OTHER_HIGH]) - max(mine[OTHER_LOW], yours[OTHER_LOW])
            if other < LEAST_SHARE * min(other_length, yours[OTHER_HIGH] - yours[OTHER_LOW]):
                continue
            turn = yours[HEADING] - mine[HEADING] + trust * (yours[ANGLE] - mine[ANGLE])
            if count == len(votes):
                larger = np.empty((2 * count, 4))
                larger[:count] = votes
                votes = larger
            c, s = math.cos(turn), math.sin(turn)
            votes[count, 0], votes[count, 1] = yours[X] + c * dx - s * dy, yours[Y] + s * dx + c * dy
            votes[count, 2], votes[count, 3] = turn % (2 * math.pi), min(MOST_VOTE, overlap, other)
            count += 1
    return votes[:count]


@njit(cache=True)
def _corner_votes(corners, headings, others, other_headings):  # type: ignore[no-untyped-def]
    """The same of corners."""
    count = 0
    votes = np.empty((len(corners) * len(others), 4))
    for i in range(len(corners)):
        for j in range(len(others)):
            first = turn_of(other_headings[j, 0] - headings[i, 0])
            difference = turn_of(other_headings[j, 1] - headings[i, 1] - first)
            if abs(difference) > CORNER_TURN:
                continue
            turn = first + 0.5 * difference
            dx, dy = -corners[i, 0], -corners[i, 1]
            c, s = math.cos(turn), math.sin(turn)
            votes[count, 0], votes[count, 1] = others[j, 0] + c * dx - s * dy, others[j, 1] + s * dx + c * dy
            votes[count, 2], votes[count, 3] = turn % (2 * math.pi), CORNER_VOTE
            count += 1
    return votes[:count]
