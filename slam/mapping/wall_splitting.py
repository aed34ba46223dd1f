"""Detection of walls that are one landmark but two surfaces: stretches on either side of a part that was never seen.

The side of a cabinet and a partition behind it may be parallel and a few centimetres apart. When the second one is seen
first, its place is too uncertain to tell them apart. So both become one landmark, which seems certain by its many
observations. When the estimate is settled, each observed stretch of such a wall gets a landmark of its own on a copy of
the graph. The offset o and the heading h between the lines of two stretches have the covariance C. If they are one
line, these have the density p1 = N([o, h]; 0, C). If they are two surfaces that were taken for one, the offset is
anywhere within the limits of association, and the surfaces are parallel or not, with equal probability:

    p2 = (N(h; 0, C_hh) + 1 / (2 MAX_HEADING_DIFFERENCE)) / 2 / (2 MAX_OFFSET)

Stretches are joined again, those with the largest p1 / p2 first, until it is below one for all.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Sequence

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ..geometry.roughness import Roughness, add_roughness
from ..geometry.segments import Floats
from ..graph.factor_graph import CLOSING_UPDATES, FactorGraph
from ..graph.wall_segments import WallSegment, wall_segments
from .data_association import ASSOCIATION_GATE
from .keyframes import LandmarkIds
from .landmarks import Landmarks
from .local_map import MAX_HEADING_DIFFERENCE, MAX_OFFSET
from .wall_cells import WALL_CELL

# Squared Mahalanobis distance between two stretches, with the poses held fixed, above which a wall is tried. Free poses
# change it little where other walls determine them. Origin: chosen, a quarter of the gate of an observation, below what
# the evidence requires if the offset is known to 4 cm; not measured.
CANDIDATE_GATE = 0.25 * ASSOCIATION_GATE


@immutable
class Stretch:
    """An observed stretch of a wall.

    wall        landmark id of the wall
    low, high   metres along the wall's frame
    frame       (3,) in the map, in the middle of the stretch, on the line that fits its segments
    segments    observations of it
    covariance  (2, 2) of offset and heading at the frame, with the poses of the observers held fixed
    """

    wall: int
    low: float
    high: float
    frame: se2.Pose
    segments: list[WallSegment]
    covariance: Floats

    @property
    def keyframes(self) -> set[int]:
        """Keyframes that observed the stretch."""
        return {segment.keyframe for segment in self.segments}


@immutable
class Split:
    """Stretches of the wall `wall` that are another surface than the rest of it.

    frame  (3,) in the map, on the other surface, in the middle of its first stretch
    rest   keyframes that observed the rest of the wall
    """

    wall: int
    frame: se2.Pose
    stretches: list[Stretch]
    rest: set[int]

    @property
    def segments(self) -> list[WallSegment]:
        """Observations of the other surface."""
        return [segment for stretch in self.stretches for segment in stretch.segments]


def find_splits(landmarks: Landmarks, graph: FactorGraph, poses: Floats, roughness: Roughness) -> list[Split]:
    """Return the parts of walls that are surfaces of their own.

    The graph is solved and `poses` (k, 3) are those of its keyframes; `roughness` is that of the walls.
    Neither landmarks nor graph are changed.
    """
    walls = [stretches for stretches in _stretches(landmarks, graph, poses) if _may_differ(stretches, roughness)]
    if not walls:
        return []
    trial, first_new = copy.deepcopy(graph), len(landmarks.walls)
    ids: list[list[int]] = []
    moves: list[tuple[int, se2.Pose, list[WallSegment]]] = []
    for stretches in walls:
        new = list(range(first_new, first_new + len(stretches) - 1))
        first_new += len(new)
        ids.append([stretches[0].wall, *new])
        moves += [(wall, stretch.frame, stretch.segments) for wall, stretch in zip(new, stretches[1:], strict=True)]
    trial.move_wall_segments(moves)
    trial.update_until_converged(CLOSING_UPDATES)
    splits = []
    for stretches, own, covariance in zip(walls, ids, trial.wall_covariances(ids), strict=True):
        groups = _group_compatible(stretches, trial.wall_frames(own), covariance, roughness)
        kept = next(group for group in groups if 0 in group)
        rest = set().union(*(stretches[i].keyframes for i in kept))
        splits += [
            Split(stretches[0].wall, stretches[group[0]].frame, [stretches[i] for i in group], rest)
            for group in groups
            if group is not kept
        ]
    return splits


def split_landmark(landmarks: Landmarks, split: Split) -> int:
    """Make the stretches of a split a wall of their own, and return its id."""
    keyframes = set().union(*(stretch.keyframes for stretch in split.stretches))
    new = landmarks.add_wall(split.frame, 0.0, min(keyframes))
    row, rest = landmarks.walls.rows[new], landmarks.walls.rows[split.wall]
    along = float(se2.between(rest["frame"], split.frame)[0])
    shift = round(along / WALL_CELL)
    cells = {
        cell
        for stretch in split.stretches
        for cell in range(math.floor(stretch.low / WALL_CELL), math.ceil(stretch.high / WALL_CELL))
    }
    landmarks.covered[new] = frozenset(cell - shift for cell in landmarks.covered[split.wall] & cells)
    landmarks.covered[split.wall] -= cells
    opened = {cell - shift: keyframe for cell, keyframe in landmarks.opened.get(split.wall, {}).items()}
    if opened:
        landmarks.opened[new] = opened
    row["low"] = min(stretch.low for stretch in split.stretches) - along
    row["high"] = max(stretch.high for stretch in split.stretches) - along
    row["observations"], row["last_seen"], row["in_graph"] = len(keyframes), max(keyframes), True
    rest["observations"], rest["first_seen"], rest["last_seen"] = len(split.rest), min(split.rest), max(split.rest)
    landmarks.trim_extent(split.wall)
    _reassign_corners(landmarks, split, new)
    return new


def with_new_walls(
    landmark_ids: Sequence[LandmarkIds], moves: Iterable[tuple[int, se2.Pose, Sequence[WallSegment]]]
) -> list[LandmarkIds]:
    """Return the landmark ids of all keyframes after some segments became observations of new walls.

    `moves` are the id and the frame (3,) of each new wall, and its segments.
    """
    result = list(landmark_ids)
    for wall, _, segments in moves:
        for segment in segments:
            walls = result[segment.keyframe].walls.copy()
            walls[np.flatnonzero(landmark_ids[segment.keyframe].walls == segment.wall)[segment.index]] = wall
            result[segment.keyframe] = LandmarkIds(walls, landmark_ids[segment.keyframe].corners)
    return result


def _reassign_corners(landmarks: Landmarks, split: Split, new: int) -> None:
    """Replace the split wall by the new one at the corners that are on its stretches, or nearer to them."""
    corners, walls = landmarks.corners.rows, landmarks.walls.rows
    of_wall = walls["merged_into"][corners["walls"]] == split.wall
    of_wall &= corners["walls"] >= 0
    for corner, side in np.argwhere(of_wall):
        beyond = []
        for wall in (split.wall, new):
            along = se2.transform(se2.inverse(walls["frame"][wall]), corners["position"][corner])[0]
            pieces = landmarks.pieces(wall)
            beyond.append(np.maximum(pieces[:, 0] - along, along - pieces[:, 1]).min())
        if beyond[1] < beyond[0]:
            corners["walls"][corner, side] = new


def _stretches(landmarks: Landmarks, graph: FactorGraph, poses: Floats) -> list[list[Stretch]]:
    """Return the observed stretches of each active wall, the one with the most observations first."""
    rows = landmarks.walls.rows
    active = np.flatnonzero(landmarks.active())
    pieces_of = dict(zip(active.tolist(), landmarks.pieces_of_walls(active), strict=True))
    divided = [wall for wall, pieces in pieces_of.items() if len(pieces) > 1]
    kept = rows["merged_into"].tolist()
    of_wall: dict[int, list[WallSegment]] = {}
    for segment in wall_segments(graph.solver.factors, set(np.flatnonzero(np.isin(kept, divided)).tolist())):
        of_wall.setdefault(kept[segment.wall], []).append(segment)
    result = []
    for wall, segments in sorted(of_wall.items()):
        pieces = pieces_of[wall]
        frames = se2.compose(poses[[s.keyframe for s in segments]], np.array([s.frame for s in segments]))
        relative = se2.between(rows["frame"][wall], frames).reshape(-1, 3)
        beyond = np.maximum(pieces[None, :, 0] - relative[:, :1], relative[:, :1] - pieces[None, :, 1])
        piece = beyond.argmin(axis=1)
        stretches = []
        for k, (low, high) in enumerate(pieces):
            own = np.flatnonzero(piece == k)
            if not len(own):
                continue
            fitted, covariance = _fit(relative[own], [segments[i] for i in own], 0.5 * (low + high))
            frame = se2.compose(rows["frame"][wall], fitted)
            stretches.append(Stretch(wall, float(low), float(high), frame, [segments[i] for i in own], covariance))
        result.append(sorted(stretches, key=lambda stretch: -len(stretch.segments)))
    return result


def _may_differ(stretches: Sequence[Stretch], roughness: Roughness) -> bool:
    """Return True if two stretches of a wall differ with the poses held fixed; see CANDIDATE_GATE."""
    if len(stretches) < 2:
        return False
    blocks = np.zeros((2 * len(stretches), 2 * len(stretches)))
    for i, stretch in enumerate(stretches):
        blocks[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = stretch.covariance
    lines, joint = _lines_in_first(stretches, np.array([s.frame for s in stretches]), blocks, roughness)
    differences = (_difference(lines, joint, i, j) for j in range(len(stretches)) for i in range(j))
    return any(float(value @ np.linalg.solve(variance, value)) > CANDIDATE_GATE for value, variance, _ in differences)


def _fit(relative: Floats, segments: Sequence[WallSegment], along: float) -> tuple[se2.Pose, Floats]:
    """Return the frame, `along` metres along a wall, of the line through segments at `relative` (n, 3) in its frame.

    With the covariance (2, 2) of its offset and heading.
    """
    design = np.tile(np.eye(2), (len(segments), 1, 1))
    design[:, 0, 1] = relative[:, 0] - along
    weighted = design.transpose(0, 2, 1) @ np.linalg.inv(
        np.array([segment.covariance for segment in segments]).reshape(-1, 2, 2)
    )
    information = 1e-9 * np.eye(2) + (weighted @ design).sum(axis=0)
    score = (weighted @ relative[:, 1:, None]).sum(axis=0)[:, 0]
    offset, turn = np.linalg.solve(information, score)
    return np.array([along, offset, turn]), np.asarray(np.linalg.inv(information))


def _group_compatible(
    stretches: Sequence[Stretch], frames: Floats, covariance: Floats, roughness: Roughness
) -> list[list[int]]:
    """Return groups of stretches of one wall that are compatible with one line each, as indices.

    frames      (n, 3) of the landmarks of the stretches in the map
    covariance  (2 n, 2 n) of their offsets and headings, at their frames

    Two stretches that are joined are constrained to one line, and the others with them by the joint covariance.
    """
    lines, joint = _lines_in_first(stretches, frames, covariance, roughness)
    groups = [[i] for i in range(len(stretches))]
    while len(groups) > 1:
        pairs = [(a, b) for a in range(len(groups)) for b in range(a + 1, len(groups))]
        differences = [_difference(lines, joint, groups[a][0], groups[b][0]) for a, b in pairs]
        evidence = [_evidence_of_one_line(*difference[:2]) for difference in differences]
        best = int(np.argmax(evidence))
        if evidence[best] < 0.0:
            break
        jacobian = differences[best][2]
        gain = joint @ jacobian.T @ np.linalg.inv(jacobian @ joint @ jacobian.T)
        lines, joint = lines - gain @ (jacobian @ lines), joint - gain @ jacobian @ joint
        a, b = pairs[best]
        groups[a] += groups.pop(b)
    return groups


def _lines_in_first(
    stretches: Sequence[Stretch], frames: Floats, covariance: Floats, roughness: Roughness
) -> tuple[Floats, Floats]:
    """Return offsets and headings (2 n,) of all stretches at the origin of the first frame, and their covariance.

    The roughness of each stretch is added at its middle: its observations share it.
    """
    relative = se2.between(frames[0], frames).reshape(-1, 3)
    middle = se2.between(frames[0], np.array([s.frame for s in stretches])).reshape(-1, 3)[:, 0]
    lines, joint = np.zeros(2 * len(stretches)), np.zeros_like(covariance)
    to_origin = np.zeros_like(covariance)
    for i, (x, y, turn) in enumerate(relative):
        rows = slice(2 * i, 2 * i + 2)
        lines[rows] = y - x * np.tan(turn), turn
        to_origin[rows, rows] = [[1.0, -x], [0.0, 1.0]]
    joint = to_origin @ covariance @ to_origin.T
    for i, stretch in enumerate(stretches):
        rows, half = slice(2 * i, 2 * i + 2), np.array([0.5 * (stretch.high - stretch.low)])
        at_middle = add_roughness(np.zeros((1, 2, 2)), half, roughness)[0]
        shift = np.array([[1.0, -middle[i]], [0.0, 1.0]])
        joint[rows, rows] += shift @ at_middle @ shift.T
    return lines, joint


def _difference(lines: Floats, joint: Floats, one: int, other: int) -> tuple[Floats, Floats, Floats]:
    """Return offset and heading (2,) between two lines, their covariance (2, 2), and their Jacobian (2, 2 n)."""
    jacobian = np.zeros((2, len(lines)))
    jacobian[:, 2 * one : 2 * one + 2], jacobian[:, 2 * other : 2 * other + 2] = -np.eye(2), np.eye(2)
    return jacobian @ lines, jacobian @ joint @ jacobian.T, jacobian


def _evidence_of_one_line(difference: Floats, covariance: Floats) -> float:
    """Return ln(p1 / p2) of the module, from offset and heading (2,) between two lines and their covariance (2, 2)."""
    heading, variance = float(difference[1]), float(covariance[1, 1])
    offset = float(difference[0]) - float(covariance[0, 1]) / variance * heading
    of_heading = _log_normal(heading, variance)
    of_offset = _log_normal(offset, float(covariance[0, 0]) - float(covariance[0, 1]) ** 2 / variance)
    of_surfaces = math.log(0.25 / MAX_OFFSET) + float(np.logaddexp(of_heading, -math.log(2.0 * MAX_HEADING_DIFFERENCE)))
    return of_heading + of_offset - of_surfaces


def _log_normal(value: float, variance: float) -> float:
    """Return the logarithm of the density of a normal variable with the mean zero."""
    return -0.5 * (value**2 / variance + math.log(2.0 * math.pi * variance))
