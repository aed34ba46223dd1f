"""Likelihood field: distances from grid cells to the scan points of recent keyframes.

It serves two purposes: clutter such as door jambs fixes the pose along a corridor, which walls do not determine, and a
search over the field recovers the pose if odometry has failed.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.compiled import compiled

from ..geometry.segments import Floats

# Keyframes whose points make the field: about four metres of driving. Origin: chosen; not measured.
FIELD_KEYFRAMES = 15
# Points of one scan that are kept; denser scans are subsampled. Origin: chosen, above the 361 beams of a half-circle
# lidar with half-degree steps: a limit of 360 left out every other of them.
MAX_SCAN_POINTS = 400
# Metres, side of a cell. Origin: chosen, the noise of usual lidars; not measured.
FIELD_CELL = 0.05
# Metres from the robot to each side of the field. Origin: chosen, a usual range indoors; not measured. In recorded
# halls 27 to 36 % of the returns lie beyond.
FIELD_HALF_WIDTH = 12.0
# Metres from a cell within which its nearest point is stored. Origin: chosen, five cells; not measured.
MAX_FIELD_DISTANCE = 0.25
# Metres, standard deviation of the likelihood: a point this far from the nearest one scores 0.6.
# Origin: chosen, between lidar noise and the search step; not measured.
LIKELIHOOD_SIGMA = 0.10
# Metres between the positions that the pose search tries.
# Origin: chosen, about the width of the likelihood; not measured.
SEARCH_STEP = 0.15
# Metres from the prediction to the farthest position tried along each axis. Origin: chosen; not measured.
SEARCH_HALF_WIDTH = 1.5
# Radians between the headings that the pose search tries. Origin: chosen; not measured.
SEARCH_TURN_STEP = math.radians(2.5)
# Radians from the predicted heading to the farthest one tried.
# Origin: chosen, widened from 60 degrees during development on recordings; not measured.
SEARCH_HALF_TURN = math.radians(80.0)
# Points of a scan that are scored, evenly subsampled. Origin: chosen, for speed; not measured.
MAX_SCORED_POINTS = 120


@dataclass(frozen=True, slots=True, eq=False)
class ScanPoints:
    """Points of one scan in the base's frame: `all` (p, 2), and `clutter` (q, 2), those on no extracted line."""

    all: Floats
    clutter: Floats

    def transformed(self, pose: se2.Pose) -> ScanPoints:
        """Return the points in the frame in which the base is at `pose`."""
        return ScanPoints(se2.transform(pose, self.all), se2.transform(pose, self.clutter))


@dataclass(frozen=True, slots=True, eq=False)
class LikelihoodField:
    """Square grids around a position in the map; row and column of a point are floor((xy - origin) / FIELD_CELL).

    origin   (2,) corner of the grids in the map
    points   (n, 2) clutter points in the map
    nearest  (c, c) row of the clutter point nearest to the cell's centre, -1 if there is none within MAX_FIELD_DISTANCE
    squared  (c, c) squared distance (metres squared) to the nearest point of any kind, at most MAX_FIELD_DISTANCE^2
    """

    origin: Floats
    points: Floats
    nearest: NDArray[np.int32]
    squared: NDArray[np.float32]


def subsample(points: Floats, max_count: int) -> Floats:
    """Return every k-th point, with the smallest k that leaves at most `max_count`."""
    return points[:: max(1, -(-len(points) // max_count))]


class RecentPoints:
    """Points of the last FIELD_KEYFRAMES keyframes, from which the field is built."""

    def __init__(self) -> None:
        self._scans: deque[tuple[int, ScanPoints]] = deque(maxlen=FIELD_KEYFRAMES)

    @property
    def keyframes(self) -> list[int]:
        """Indices of the keyframes, oldest first."""
        return [keyframe for keyframe, _ in self._scans]

    def add(self, keyframe: int, points: ScanPoints) -> None:
        """Add the points of a keyframe and drop the oldest keyframe."""
        self._scans.append((keyframe, points))

    def build_field(self, poses: Floats, centre: se2.Pose) -> LikelihoodField:
        """Build the field around `centre`; `poses` (k, 3) are those of `keyframes` in the map."""
        points = [se2.transform(pose, scan.all) for pose, (_, scan) in zip(poses, self._scans, strict=True)]
        clutter = [se2.transform(pose, scan.clutter) for pose, (_, scan) in zip(poses, self._scans, strict=True)]
        return build_likelihood_field(
            np.concatenate(points or [np.zeros((0, 2))]), np.concatenate(clutter or [np.zeros((0, 2))]), centre[:2]
        )


def build_likelihood_field(points: Floats, clutter: Floats, centre: Floats) -> LikelihoodField:
    """Build a field around `centre` (2,) from points (n, 2) in the map and the clutter points among them (m, 2)."""
    cells = int(2 * FIELD_HALF_WIDTH / FIELD_CELL)
    origin = np.floor((centre - FIELD_HALF_WIDTH) / FIELD_CELL) * FIELD_CELL
    nearest = np.full((cells, cells), -1, dtype=np.int32)
    squared = np.full((cells, cells), MAX_FIELD_DISTANCE**2, dtype=np.float32)
    _enter_points(clutter, origin, squared, nearest)
    squared[:] = MAX_FIELD_DISTANCE**2
    _enter_points(points, origin, squared, np.empty((0, 0), dtype=np.int32))
    return LikelihoodField(origin, clutter, nearest, squared)


@compiled
def _enter_points(points, origin, squared, nearest):  # type: ignore[no-untyped-def]
    """Enter each point into the cells within MAX_FIELD_DISTANCE to which it is the nearest so far."""
    cells, span = len(squared), int(MAX_FIELD_DISTANCE / FIELD_CELL)
    for index in range(len(points)):
        x, y = points[index, 0] - origin[0], points[index, 1] - origin[1]
        row, column = math.floor(x / FIELD_CELL), math.floor(y / FIELD_CELL)
        if row < span or column < span or row >= cells - span or column >= cells - span:
            continue
        for i in range(row - span, row + span + 1):
            for j in range(column - span, column + span + 1):
                dx, dy = (i + 0.5) * FIELD_CELL - x, (j + 0.5) * FIELD_CELL - y
                distance = dx * dx + dy * dy
                if distance < squared[i, j]:
                    squared[i, j] = distance
                    if len(nearest):
                        nearest[i, j] = index


def likelihood_score(field: LikelihoodField, points: Floats, pose: se2.Pose) -> float:
    """Return the likelihood score, 0 to 1, of a scan's points (p, 2) in the base's frame with the base at `pose`."""
    return float(likelihood_scores(field, points, np.asarray(pose, dtype=np.float64).reshape(1, 3))[0])


def likelihood_scores(field: LikelihoodField, points: Floats, poses: Floats) -> Floats:
    """Return the likelihood scores (n,), 0 to 1, of a scan's points (p, 2) at each of the poses (n, 3).

    The score is the mean of exp(-d^2 / (2 LIKELIHOOD_SIGMA^2)) over at most MAX_SCORED_POINTS points, with d the
    distance of each to the nearest point of the field; points beyond MAX_FIELD_DISTANCE or off the field count 0.
    """
    return np.asarray(_likelihood_scores(field.squared, field.origin, subsample(points, MAX_SCORED_POINTS), poses))


def search_pose(field: LikelihoodField, points: Floats, prediction: se2.Pose) -> tuple[se2.Pose, float]:
    """Return the pose near the prediction with the highest likelihood score of a scan's points (p, 2), and its score.

    The search grid covers SEARCH_HALF_WIDTH and SEARCH_HALF_TURN in steps of SEARCH_STEP and SEARCH_TURN_STEP.
    """
    offsets = np.arange(-SEARCH_HALF_WIDTH, SEARCH_HALF_WIDTH + 1e-9, SEARCH_STEP)
    turns = np.arange(-SEARCH_HALF_TURN, SEARCH_HALF_TURN + 1e-9, SEARCH_TURN_STEP)
    grid = np.stack(np.meshgrid(offsets, offsets, turns, indexing="ij"), axis=-1).reshape(-1, 3)
    poses = prediction + grid
    scores = likelihood_scores(field, points, poses)
    best = int(np.argmax(scores))
    return poses[best], float(scores[best])


@compiled
def _likelihood_scores(squared, origin, points, poses):  # type: ignore[no-untyped-def]
    scores = np.zeros(len(poses))
    cells = len(squared)
    for index in range(len(poses)):
        c, s = math.cos(poses[index, 2]), math.sin(poses[index, 2])
        x0, y0 = poses[index, 0] - origin[0], poses[index, 1] - origin[1]
        total = 0.0
        for p in range(len(points)):
            x, y = x0 + c * points[p, 0] - s * points[p, 1], y0 + s * points[p, 0] + c * points[p, 1]
            i, j = int(x / FIELD_CELL), int(y / FIELD_CELL)
            if (
                x > 0.0
                and y > 0.0
                and i < cells
                and j < cells
                and squared[i, j] < MAX_FIELD_DISTANCE * MAX_FIELD_DISTANCE
            ):
                total += math.exp(-squared[i, j] / (2 * LIKELIHOOD_SIGMA * LIKELIHOOD_SIGMA))
        scores[index] = total / max(1, len(points))
    return scores
