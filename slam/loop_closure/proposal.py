"""Where the constellation of recent walls may lie on the old map.

Two walls that are not parallel, laid on two old ones, fix a rigid motion. All such pairs vote in a grid of motions
within what drift allows; the best cells are refined by Gauss-Newton on all walls, and scored by the length of wall
they explain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from drivers import se2

from ..geometry.angles import turn_of
from ..geometry.segments import Floats
from .recent_walls import RIVALS, ReferenceMap, WallSet

LONGEST = 16  # walls of the constellation that propose motions; the others only judge them
LEAST_SINE = 0.5  # of the angle between two walls that fix a motion
SAME_ANGLE = math.radians(4.0)  # by which the angle between two walls may differ from that between the old ones
CELL, CELL_TURN = 0.4, math.radians(4.0)  # metres and radians of the voting grid
BEST_CELLS = 24  # refined by Gauss-Newton: peaks, since the cells around a strong one would leave no place for others
GATES = np.array([0.5, 0.4, 0.3, 0.2, 0.15, 0.15])  # metres across, one a Gauss-Newton step; the last one judges
TURN_GATES = np.radians([8.0, 7.0, 6.0, 5.0, 4.0, 4.0])
OFFSET_SIGMA = 0.05  # metres, of how well two walls that are one agree; walls are weighted by their length besides
OVERLAP_MARGIN = 0.3  # metres beyond an old wall's known end where it may go on
KNOWN_AROUND = 1.0  # metres around an old wall where the old map has been
MOVED, MOVED_TURN = 0.2, math.radians(4.0)  # a motion smaller than this leaves the robot where it is
DISTINCT, DISTINCT_TURN = 0.5, math.radians(10.0)  # motions farther apart than this are different answers


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A motion of the recent constellation onto the old map.

    motion       [x, y, heading]: a recent thing at p in the map lies at transform(motion, p)
    explained    share of the constellation's length that falls on old walls, of what lies where the old map has been
    length       metres of it that do
    weakest      share of what lies where the old map has been that falls on old walls, of the walls that tell of the
                 direction in which that is least: a place where only the walls along a corridor agree may be any there
    information  (3, 3) of the motion from the matched walls, in the map's axes about the robot
    matches      (n,) row of the old map for each recent wall, -1 for none
    """

    motion: se2.Pose
    overlap_ratio: float
    length: float
    weakest: float
    information: Floats
    matches: NDArray[np.int64]


def propose(recent: WallSet, old: ReferenceMap, pose: se2.Pose) -> list[Hypothesis]:
    """First that the robot is where it is believed to be; then others, those that explain most length first."""
    if len(recent) < 3 or len(old.wall_set) < 3:
        return []
    order = np.argsort(-recent.half_length, kind="stable")[:LONGEST]
    translation, rotation = RIVALS * old.translation, RIVALS * old.rotation
    reach, turn = float(translation.max()), float(rotation.max())
    votes = _vote(
        recent.frame[order], recent.half_length[order], old.wall_set.frame, old.wall_set.half_length,
        translation, rotation, pose[:2], reach, turn,
    )  # fmt: skip
    peaks = np.flatnonzero((votes > 0.0) & (votes == maximum_filter(votes, size=3, mode="constant")))
    flat = peaks[np.argsort(-votes.ravel()[peaks], kind="stable")[:BEST_CELLS]]
    cells = np.column_stack(np.unravel_index(flat, votes.shape)).astype(float)
    starts = np.column_stack([(cells[:, :2] + 0.5) * CELL - reach - CELL, (cells[:, 2] + 0.5) * CELL_TURN - turn])
    stay = refined(np.zeros(3), recent, old, pose, first=len(GATES) - 1)
    found: list[Hypothesis] = []
    for start in starts:
        hypothesis = refined(start, recent, old, pose)
        if not distinct(hypothesis.motion, stay.motion, pose, by=MOVED, turn=MOVED_TURN):
            continue
        equal = [row for row, other in enumerate(found) if not distinct(hypothesis.motion, other.motion, pose)]
        if not equal:
            found.append(hypothesis)
        elif hypothesis.length > found[equal[0]].length:
            found[equal[0]] = hypothesis
    return [stay, *sorted(found, key=lambda hypothesis: -hypothesis.length)]


def refined(start: Floats, recent: WallSet, old: ReferenceMap, pose: se2.Pose, first: int = 0) -> Hypothesis:
    """The best motion near `start`, which is [shift x, shift y, turn about the robot] in metres and radians.

    `first` is the gate to begin with; the last one leaves the motion as it is and only judges it.
    """
    motion, information, matches, length, covered, agreeing, telling = _refine(
        start, recent.frame, recent.half_length, old.wall_set.frame, old.wall_set.half_length, pose[:2], first
    )
    share = length / covered if covered else 0.0
    weakest = float(np.clip(np.linalg.eigvals(np.linalg.solve(telling, agreeing)).real.min(), 0.0, 1.0))
    return Hypothesis(_about_origin(motion, pose), share, length, weakest, information, matches)


def distinct(
    motion: se2.Pose, other: se2.Pose, pose: se2.Pose, by: float = DISTINCT, turn: float = DISTINCT_TURN
) -> bool:
    """Whether two motions put the robot at `pose` at different places."""
    x, y, heading = motion - other
    c, s = math.cos(motion[2]) - math.cos(other[2]), math.sin(motion[2]) - math.sin(other[2])
    apart = math.hypot(x + c * pose[0] - s * pose[1], y + s * pose[0] + c * pose[1])
    return apart > by or abs(turn_of(heading)) > turn


def _about_origin(motion: se2.Pose, pose: se2.Pose) -> se2.Pose:
    """A motion [shift, turn about the robot] as a motion about the map's origin."""
    there = np.array([pose[0] + motion[0], pose[1] + motion[1], motion[2]])
    return se2.compose(there, np.array([-pose[0], -pose[1], 0.0]))


@njit(cache=True)
def _vote(  # type: ignore[no-untyped-def]
    frames, halves, olds, old_halves, translations, rotations, centre, reach, turn
):
    """Votes, in metres of wall, for cells of motions [shift x, shift y, turn about `centre`]."""
    across = 2 * math.ceil((reach + CELL) / CELL) + 1
    votes = np.zeros((across, across, 2 * math.ceil(turn / CELL_TURN) + 1))
    turns = np.empty((len(frames), len(olds)))
    for a in range(len(frames)):
        for c in range(len(olds)):
            turns[a, c] = turn_of(olds[c, 2] - frames[a, 2])
    normals = np.column_stack((-np.sin(olds[:, 2]), np.cos(olds[:, 2])))
    for a in range(len(frames)):
        for b in range(a + 1, len(frames)):
            angle = turn_of(frames[b, 2] - frames[a, 2])
            if abs(math.sin(angle)) < LEAST_SINE:
                continue
            for c in range(len(olds)):
                first = turns[a, c]
                if abs(first) > rotations[c]:
                    continue
                for d in range(len(olds)):
                    second = turns[b, d]
                    if d == c or abs(second) > rotations[d] or abs(second - first) > SAME_ANGLE:
                        continue
                    rotation = 0.5 * (first + second)
                    rc, rs = math.cos(rotation), math.sin(rotation)
                    # offsets of the turned walls' middles from the old walls, along the old walls' normals
                    (nxc, nyc), (nxd, nyd) = normals[c], normals[d]
                    ax, ay = frames[a, 0] - centre[0], frames[a, 1] - centre[1]
                    bx, by = frames[b, 0] - centre[0], frames[b, 1] - centre[1]
                    ax, ay = centre[0] + rc * ax - rs * ay, centre[1] + rs * ax + rc * ay
                    bx, by = centre[0] + rc * bx - rs * by, centre[1] + rs * bx + rc * by
                    oc = nxc * (olds[c, 0] - ax) + nyc * (olds[c, 1] - ay)
                    od = nxd * (olds[d, 0] - bx) + nyd * (olds[d, 1] - by)
                    determinant = nxc * nyd - nyc * nxd
                    x, y = (oc * nyd - od * nyc) / determinant, (nxc * od - nxd * oc) / determinant
                    if math.hypot(x, y) > min(translations[c], translations[d]):
                        continue
                    along_c = nyc * (ax + x - olds[c, 0]) - nxc * (ay + y - olds[c, 1])
                    along_d = nyd * (bx + x - olds[d, 0]) - nxd * (by + y - olds[d, 1])
                    if abs(along_c) > halves[a] + old_halves[c] or abs(along_d) > halves[b] + old_halves[d]:
                        continue
                    i = int((x + reach + CELL) / CELL)
                    j = int((y + reach + CELL) / CELL)
                    k = int((rotation + turn) / CELL_TURN)
                    votes[i, j, k] += min(min(halves[a], old_halves[c]), min(halves[b], old_halves[d]))
    return votes


@njit(cache=True)
def _refine(start, frames, halves, olds, old_halves, centre, first):  # type: ignore[no-untyped-def]
    """Gauss-Newton on [shift x, shift y, turn about centre]; the motion, its information, matches, the length explained
    and the length of the walls that lie where the old map has been; and (2, 2) for each direction, how much length of
    walls that tell of it agrees, and how much there is."""
    motion = start.copy()
    agreeing, telling = np.zeros((2, 2)), 1e-6 * np.eye(2)
    matches = np.full(len(frames), -1)
    information, length, covered = np.zeros((3, 3)), 0.0, 0.0
    cosines, sines = np.cos(olds[:, 2]), np.sin(olds[:, 2])
    for step in range(first, len(GATES)):
        judging = step == len(GATES) - 1
        information, gradient, length, covered = np.eye(3) * 1e-3, np.zeros(3), 0.0, 0.0
        c, s = math.cos(motion[2]), math.sin(motion[2])
        for i in range(len(frames)):
            x, y = frames[i, 0] - centre[0], frames[i, 1] - centre[1]
            lever_x, lever_y = c * x - s * y, s * x + c * y
            x, y = centre[0] + lever_x + motion[0], centre[1] + lever_y + motion[1]
            best, overlap, offset, turned, known = np.inf, 0.0, 0.0, 0.0, False
            matches[i] = -1
            for j in range(len(olds)):
                oc, os = cosines[j], sines[j]
                dx, dy = x - olds[j, 0], y - olds[j, 1]
                across, along = -os * dx + oc * dy, oc * dx + os * dy
                if judging and not known:
                    known = math.hypot(across, max(0.0, abs(along) - old_halves[j])) < KNOWN_AROUND
                if abs(across) > GATES[step]:
                    continue
                angle = turn_of(frames[i, 2] + motion[2] - olds[j, 2])
                if abs(angle) > TURN_GATES[step]:
                    continue
                reach = old_halves[j] + OVERLAP_MARGIN
                shared = min(along + halves[i], reach) - max(along - halves[i], -reach)
                distance = (across / GATES[step]) ** 2 + (angle / TURN_GATES[step]) ** 2
                if shared > 0.0 and distance < best:
                    best, overlap, offset, turned, matches[i] = distance, min(shared, 2 * halves[i]), across, angle, j
            if known:
                covered += 2 * halves[i]
            if judging and (known or matches[i] >= 0):
                normal = np.array([-math.sin(frames[i, 2] + motion[2]), math.cos(frames[i, 2] + motion[2])])
                outer = 2 * halves[i] * np.outer(normal, normal)
                telling += outer
                if matches[i] >= 0:
                    agreeing += outer
            if matches[i] < 0:
                continue
            length += overlap
            nx, ny = -sines[matches[i]], cosines[matches[i]]
            lever = -nx * lever_y + ny * lever_x
            row = np.array([nx, ny, lever])
            weight = overlap / OFFSET_SIGMA**2
            turn_weight = weight * halves[i] ** 2 / 3.0
            for p in range(3):
                gradient[p] += weight * row[p] * offset
                for q in range(3):
                    information[p, q] += weight * row[p] * row[q]
            information[2, 2] += turn_weight
            gradient[2] += turn_weight * turned
        if not judging:
            motion = motion - np.linalg.solve(information, gradient)
    return motion, information, matches, length, max(covered, length), agreeing, telling
