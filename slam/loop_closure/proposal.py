"""Proposal of loop closure hypotheses: motions of the recent walls onto the reference map.

Two walls that are not parallel, matched with two reference walls, determine a rigid motion. All such pairs vote in a
grid of motions within the expected drift; the best cells are refined by Gauss-Newton on all walls, and the hypotheses
are scored by the wall length that they explain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from drivers import se2
from drivers.compiled import compiled

from ..geometry.angles import wrap_angle
from ..geometry.segments import Floats
from .recent_walls import ALTERNATIVE_REACH, ReferenceMap, WallSet

# Longest recent walls that vote; the others only score hypotheses. Origin: chosen, for speed; not measured.
MAX_VOTING_WALLS = 16
# Sine of the least angle between two walls that determine a motion: 30 degrees.
# Origin: chosen, for conditioning; not measured.
MIN_PAIR_SINE = 0.5
# Radians by which the angle between two recent walls may differ from that between the reference walls.
# Origin: chosen; not measured.
VOTE_ANGLE_TOLERANCE = math.radians(4.0)
# Metres, side of a cell of the voting grid. Origin: chosen, below the first offset gate; not measured.
VOTE_CELL = 0.4
# Radians, size of a cell of the voting grid. Origin: chosen, below the first heading gate; not measured.
VOTE_CELL_TURN = math.radians(4.0)
# Peaks of the voting grid that are refined; peaks rather than cells, as the cells around a strong peak would leave no
# room for others. Origin: chosen, for speed; not measured. That they are peaks: tuned on simulated drives.
MAX_REFINED_PEAKS = 24
# Metres across between two matched walls, for each Gauss-Newton step; the last step only scores.
# Origin: chosen, after those of scan matching; not measured.
LOOP_OFFSET_GATES = np.array([0.5, 0.4, 0.3, 0.2, 0.15, 0.15])
# Radians between two matched walls, for each Gauss-Newton step.
# Origin: chosen, after those of scan matching; not measured.
LOOP_HEADING_GATES = np.radians([8.0, 7.0, 6.0, 5.0, 4.0, 4.0])
# Metres, standard deviation of the offset between two observations of one wall, per metre of wall.
# Origin: chosen; not measured.
WALL_OFFSET_SIGMA = 0.05
# Metres beyond the known end of a reference wall in which a recent wall still overlaps with it.
# Origin: chosen; not measured.
REFERENCE_END_MARGIN = 0.3
# Metres around a reference wall that count as mapped.
# Origin: tuned on Intel, fr079, CSAIL, together with MIN_OVERLAP_RATIO.
MAPPED_RADIUS = 1.0
# Metres by which a hypothesis must move the robot to differ from the null hypothesis. Origin: chosen; not measured.
MIN_HYPOTHESIS_SHIFT = 0.2
# Radians, likewise; either suffices. Origin: chosen; not measured.
MIN_HYPOTHESIS_TURN = math.radians(4.0)
# Metres between two robot positions from which on they are different places. Origin: chosen; not measured.
DISTINCT_SHIFT = 0.5
# Radians, likewise; either suffices. Origin: chosen; not measured.
DISTINCT_TURN = math.radians(10.0)


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """Candidate motion of the recent walls onto the reference map.

    motion                 [x, y, heading]: a point p of the recent walls moves to transform(motion, p) in the map
    overlap_ratio          share of the recent wall length in the mapped area that falls on reference walls
    length                 metres of recent wall that fall on reference walls
    min_directional_ratio  overlap ratio of the walls that constrain one direction, for the direction in which it is
                           least; if only the walls along a corridor match, the place may be anywhere in it
    information            (3, 3) of the motion from the matched walls, in the map's axes about the robot
    matches                (n,) row of the reference wall for each recent wall, -1 for none
    """

    motion: se2.Pose
    overlap_ratio: float
    length: float
    min_directional_ratio: float
    information: Floats
    matches: NDArray[np.int64]


def propose(recent: WallSet, reference: ReferenceMap, pose: se2.Pose) -> list[Hypothesis]:
    """Return the null hypothesis and then all distinct hypotheses, by descending wall length.

    `pose` is the robot's in the map. Empty if there are fewer than three recent or reference walls.
    """
    if len(recent) < 3 or len(reference.wall_set) < 3:
        return []
    order = np.argsort(-recent.half_length, kind="stable")[:MAX_VOTING_WALLS]
    translation, rotation = ALTERNATIVE_REACH * reference.translation, ALTERNATIVE_REACH * reference.rotation
    reach, turn = float(translation.max()), float(rotation.max())
    votes = _vote(
        recent.frame[order], recent.half_length[order], reference.wall_set.frame, reference.wall_set.half_length,
        translation, rotation, pose[:2], reach, turn,
    )  # fmt: skip
    peaks = np.flatnonzero((votes > 0.0) & (votes == maximum_filter(votes, size=3, mode="constant")))
    flat = peaks[np.argsort(-votes.ravel()[peaks], kind="stable")[:MAX_REFINED_PEAKS]]
    cells = np.column_stack(np.unravel_index(flat, votes.shape)).astype(float)
    starts = np.column_stack(
        [(cells[:, :2] + 0.5) * VOTE_CELL - reach - VOTE_CELL, (cells[:, 2] + 0.5) * VOTE_CELL_TURN - turn]
    )
    null = refine_hypothesis(np.zeros(3), recent, reference, pose, first=len(LOOP_OFFSET_GATES) - 1)
    found: list[Hypothesis] = []
    for start in starts:
        hypothesis = refine_hypothesis(start, recent, reference, pose)
        if not are_distinct(hypothesis.motion, null.motion, pose, shift=MIN_HYPOTHESIS_SHIFT, turn=MIN_HYPOTHESIS_TURN):
            continue
        equal = [row for row, other in enumerate(found) if not are_distinct(hypothesis.motion, other.motion, pose)]
        if not equal:
            found.append(hypothesis)
        elif hypothesis.length > found[equal[0]].length:
            found[equal[0]] = hypothesis
    return [null, *sorted(found, key=lambda hypothesis: -hypothesis.length)]


def refine_hypothesis(
    start: Floats, recent: WallSet, reference: ReferenceMap, pose: se2.Pose, first: int = 0
) -> Hypothesis:
    """Refine a motion by Gauss-Newton and score it.

    start  [shift x, shift y, turn about the robot], metres and radians
    first  step (index of the gates) to begin with; with the last one the motion is only scored
    """
    motion, information, matches, length, mapped, agreeing, constraining = _refine(
        start, recent.frame, recent.half_length, reference.wall_set.frame, reference.wall_set.half_length, pose[:2],
        first,
    )  # fmt: skip
    share = length / mapped if mapped else 0.0
    ratios = np.linalg.eigvals(np.linalg.solve(constraining, agreeing)).real
    least = float(np.clip(ratios.min(), 0.0, 1.0))
    return Hypothesis(_about_origin(motion, pose), share, length, least, information, matches)


def are_distinct(
    motion: se2.Pose, other: se2.Pose, pose: se2.Pose, shift: float = DISTINCT_SHIFT, turn: float = DISTINCT_TURN
) -> bool:
    """True if two motions move a robot at `pose` to poses more than `shift` metres or `turn` radians apart."""
    x, y, heading = motion - other
    c, s = math.cos(motion[2]) - math.cos(other[2]), math.sin(motion[2]) - math.sin(other[2])
    apart = math.hypot(x + c * pose[0] - s * pose[1], y + s * pose[0] + c * pose[1])
    return apart > shift or abs(wrap_angle(heading)) > turn


def _about_origin(motion: se2.Pose, pose: se2.Pose) -> se2.Pose:
    """Convert a motion [shift, turn about the robot] into a motion about the map's origin."""
    there = np.array([pose[0] + motion[0], pose[1] + motion[1], motion[2]])
    return se2.compose(there, np.array([-pose[0], -pose[1], 0.0]))


@compiled
def _vote(  # type: ignore[no-untyped-def]
    frames, halves, references, reference_halves, translations, rotations, centre, reach, turn
):
    """Return the votes, in metres of wall, for cells of motions [shift x, shift y, turn about `centre`]."""
    across = 2 * math.ceil((reach + VOTE_CELL) / VOTE_CELL) + 1
    votes = np.zeros((across, across, 2 * math.ceil(turn / VOTE_CELL_TURN) + 1))
    turns = np.empty((len(frames), len(references)))
    for a in range(len(frames)):
        for c in range(len(references)):
            turns[a, c] = wrap_angle(references[c, 2] - frames[a, 2])
    normals = np.column_stack((-np.sin(references[:, 2]), np.cos(references[:, 2])))
    for a in range(len(frames)):
        for b in range(a + 1, len(frames)):
            angle = wrap_angle(frames[b, 2] - frames[a, 2])
            if abs(math.sin(angle)) < MIN_PAIR_SINE:
                continue
            for c in range(len(references)):
                first = turns[a, c]
                if abs(first) > rotations[c]:
                    continue
                for d in range(len(references)):
                    second = turns[b, d]
                    if d == c or abs(second) > rotations[d] or abs(second - first) > VOTE_ANGLE_TOLERANCE:
                        continue
                    rotation = 0.5 * (first + second)
                    rc, rs = math.cos(rotation), math.sin(rotation)
                    # Offsets of the turned walls' middles from the reference walls, along the latter's normals.
                    (nxc, nyc), (nxd, nyd) = normals[c], normals[d]
                    ax, ay = frames[a, 0] - centre[0], frames[a, 1] - centre[1]
                    bx, by = frames[b, 0] - centre[0], frames[b, 1] - centre[1]
                    ax, ay = centre[0] + rc * ax - rs * ay, centre[1] + rs * ax + rc * ay
                    bx, by = centre[0] + rc * bx - rs * by, centre[1] + rs * bx + rc * by
                    oc = nxc * (references[c, 0] - ax) + nyc * (references[c, 1] - ay)
                    od = nxd * (references[d, 0] - bx) + nyd * (references[d, 1] - by)
                    determinant = nxc * nyd - nyc * nxd
                    x, y = (oc * nyd - od * nyc) / determinant, (nxc * od - nxd * oc) / determinant
                    if math.hypot(x, y) > min(translations[c], translations[d]):
                        continue
                    along_c = nyc * (ax + x - references[c, 0]) - nxc * (ay + y - references[c, 1])
                    along_d = nyd * (bx + x - references[d, 0]) - nxd * (by + y - references[d, 1])
                    if abs(along_c) > halves[a] + reference_halves[c] or abs(along_d) > halves[b] + reference_halves[d]:
                        continue
                    i = int((x + reach + VOTE_CELL) / VOTE_CELL)
                    j = int((y + reach + VOTE_CELL) / VOTE_CELL)
                    k = int((rotation + turn) / VOTE_CELL_TURN)
                    votes[i, j, k] += min(min(halves[a], reference_halves[c]), min(halves[b], reference_halves[d]))
    return votes


@compiled
def _refine(start, frames, halves, references, reference_halves, centre, first):  # type: ignore[no-untyped-def]
    """Run Gauss-Newton on [shift x, shift y, turn about centre].

    Returns the motion, its information, the matches, the matched wall length, the wall length in the mapped area, and
    (2, 2) length-weighted outer products of the wall normals: of the matched walls, and of all in the mapped area.
    """
    motion = start.copy()
    agreeing, constraining = np.zeros((2, 2)), 1e-6 * np.eye(2)
    matches = np.full(len(frames), -1)
    information, length, mapped = np.zeros((3, 3)), 0.0, 0.0
    cosines, sines = np.cos(references[:, 2]), np.sin(references[:, 2])
    for step in range(first, len(LOOP_OFFSET_GATES)):
        scoring = step == len(LOOP_OFFSET_GATES) - 1
        information, gradient, length, mapped = np.eye(3) * 1e-3, np.zeros(3), 0.0, 0.0
        c, s = math.cos(motion[2]), math.sin(motion[2])
        for i in range(len(frames)):
            x, y = frames[i, 0] - centre[0], frames[i, 1] - centre[1]
            lever_x, lever_y = c * x - s * y, s * x + c * y
            x, y = centre[0] + lever_x + motion[0], centre[1] + lever_y + motion[1]
            matches[i], overlap, offset, turned, in_mapped_area = _match_wall(
                x, y, frames[i, 2] + motion[2], halves[i], references, reference_halves, cosines, sines, step, scoring
            )
            if in_mapped_area:
                mapped += 2 * halves[i]
            if scoring and (in_mapped_area or matches[i] >= 0):
                normal = np.array([-math.sin(frames[i, 2] + motion[2]), math.cos(frames[i, 2] + motion[2])])
                outer = 2 * halves[i] * np.outer(normal, normal)
                constraining += outer
                if matches[i] >= 0:
                    agreeing += outer
            if matches[i] < 0:
                continue
            length += overlap
            nx, ny = -sines[matches[i]], cosines[matches[i]]
            lever = -nx * lever_y + ny * lever_x
            row = np.array([nx, ny, lever])
            weight = overlap / WALL_OFFSET_SIGMA**2
            turn_weight = weight * halves[i] ** 2 / 3.0
            for p in range(3):
                gradient[p] += weight * row[p] * offset
                for q in range(3):
                    information[p, q] += weight * row[p] * row[q]
            information[2, 2] += turn_weight
            gradient[2] += turn_weight * turned
        if not scoring:
            motion = motion - np.linalg.solve(information, gradient)
    return motion, information, matches, length, max(mapped, length), agreeing, constraining


@compiled
def _match_wall(  # type: ignore[no-untyped-def]
    x, y, heading, half, references, reference_halves, cosines, sines, step, scoring
):
    """Match a wall at (x, y, heading) with the nearest reference wall inside the gates.

    Returns the row of that wall (-1 for none), overlap in metres, offset, heading difference, and, if `scoring`,
    whether the wall is in the mapped area.
    """
    match, best, overlap, offset, turned, in_mapped_area = -1, np.inf, 0.0, 0.0, 0.0, False
    for j in range(len(references)):
        rc, rs = cosines[j], sines[j]
        dx, dy = x - references[j, 0], y - references[j, 1]
        across, along = -rs * dx + rc * dy, rc * dx + rs * dy
        if scoring and not in_mapped_area:
            beyond = max(0.0, abs(along) - reference_halves[j])
            in_mapped_area = math.hypot(across, beyond) < MAPPED_RADIUS
        if abs(across) > LOOP_OFFSET_GATES[step]:
            continue
        angle = wrap_angle(heading - references[j, 2])
        if abs(angle) > LOOP_HEADING_GATES[step]:
            continue
        reach = reference_halves[j] + REFERENCE_END_MARGIN
        shared = min(along + half, reach) - max(along - half, -reach)
        distance = (across / LOOP_OFFSET_GATES[step]) ** 2 + (angle / LOOP_HEADING_GATES[step]) ** 2
        if shared > 0.0 and distance < best:
            best, overlap, offset, turned, match = distance, min(shared, 2 * half), across, angle, j
    return match, overlap, offset, turned, in_mapped_area
