"""The raw points of the last keyframes, for what walls do not tell: door jambs and clutter that fix the pose along a
corridor, and finding the pose again when odometry has failed."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats

KEYFRAMES = 15  # whose points are kept: some four metres of driving
MOST_POINTS = 400  # of a scan; of denser ones every other, or every third: half a circle by half degrees is 361
CELL = 0.05  # metres
REACH = 12.0  # metres around the robot that the field covers
RADIUS = 0.25  # metres from a cell within which its nearest point is known
SEARCH_SIGMA = 0.10  # metres: a point this far from a known one scores 0.6
SEARCH_STEP, SEARCH_HALF_WIDTH = 0.15, 1.5  # metres around the prediction
SEARCH_TURN_STEP, SEARCH_HALF_TURN = math.radians(2.5), math.radians(80.0)
SEARCH_POINTS = 120  # of the scan, evenly taken


@dataclass(frozen=True, slots=True, eq=False)
class ScanPoints:
    """The points of a scan in the base's frame: `all` (p, 2), and `loose` (q, 2), those that lie on no line."""

    all: Floats
    loose: Floats

    def seen_from(self, pose: se2.Pose) -> ScanPoints:
        """The same points where the base stands at `pose`, in the frame that this is given in."""
        return ScanPoints(se2.transform(pose, self.all), se2.transform(pose, self.loose))


@dataclass(frozen=True, slots=True, eq=False)
class LikelihoodField:
    """Square grids around a place in the map; row and column of a point are floor((xy - origin) / CELL).

    points    (n, 2) loose points in the map
    nearest   (c, c) the loose point nearest to each cell's middle, -1 where none is within RADIUS
    squared   (c, c) squared distance (metres squared) to the nearest point of any kind, RADIUS^2 where none is near
    """

    origin: Floats
    points: Floats
    nearest: NDArray[np.int32]
    squared: NDArray[np.float32]


def thinned(points: Floats, most: int) -> Floats:
    """Every k-th point so that at most `most` are left."""
    return points[:: max(1, -(-len(points) // most))]


class RecentPoints:
    """The points of the last keyframes, from which the field is made."""

    def __init__(self) -> None:
        self._scans: deque[tuple[int, ScanPoints]] = deque(maxlen=KEYFRAMES)

    @property
    def keyframes(self) -> list[int]:
        """The keyframes whose points are kept."""
        return [keyframe for keyframe, _ in self._scans]

    def add(self, keyframe: int, points: ScanPoints) -> None:
        """Keep the points of a keyframe, and forget the oldest."""
        self._scans.append((keyframe, points))

    def field(self, poses: Floats, centre: se2.Pose) -> LikelihoodField:
        """The field around `centre`; `poses` (k, 3) are those of `keyframes` in the map."""
        everything = [se2.transform(pose, scan.all) for pose, (_, scan) in zip(poses, self._scans, strict=True)]
        loose = [se2.transform(pose, scan.loose) for pose, (_, scan) in zip(poses, self._scans, strict=True)]
        return make_field(
            np.concatenate(everything or [np.zeros((0, 2))]), np.concatenate(loose or [np.zeros((0, 2))]), centre[:2]
        )


def make_field(everything: Floats, loose: Floats, centre: Floats) -> LikelihoodField:
    """A field around `centre` (2,) of points (n, 2), and of the loose ones among them (m, 2)."""
    cells = int(2 * REACH / CELL)
    origin = np.floor((centre - REACH) / CELL) * CELL
    nearest = np.full((cells, cells), -1, dtype=np.int32)
    squared = np.full((cells, cells), RADIUS**2, dtype=np.float32)
    _spread(loose, origin, squared, nearest)
    squared[:] = RADIUS**2
    _spread(everything, origin, squared, np.empty((0, 0), dtype=np.int32))
    return LikelihoodField(origin, loose, nearest, squared)


@njit(cache=True)
def _spread(points, origin, squared, nearest):  # type: ignore[no-untyped-def]
    """Write each point into the cells within RADIUS for which it is the nearest so far."""
    cells, span = len(squared), int(RADIUS / CELL)
    for index in range(len(points)):
        x, y = points[index, 0] - origin[0], points[index, 1] - origin[1]
        row, column = math.floor(x / CELL), math.floor(y / CELL)
        if row < span or column < span or row >= cells - span or column >= cells - span:
            continue
        for i in range(row - span, row + span + 1):
            for j in range(column - span, column + span + 1):
                dx, dy = (i + 0.5) * CELL - x, (j + 0.5) * CELL - y
                distance = dx * dx + dy * dy
                if distance < squared[i, j]:
                    squared[i, j] = distance
                    if len(nearest):
                        nearest[i, j] = index


def likelihood_score(field: LikelihoodField, points: Floats, pose: se2.Pose) -> float:
    """How well a scan's points (p, 2), in the base's frame at `pose`, lie on those of the last keyframes: 0 to 1."""
    return float(likelihood_scores(field, points, np.asarray(pose, dtype=np.float64).reshape(1, 3))[0])


def likelihood_scores(field: LikelihoodField, points: Floats, poses: Floats) -> Floats:
    """(n,): how well a scan's points (p, 2) lie there at each of the poses (n, 3)."""
    return np.asarray(_likelihood_scores(field.squared, field.origin, thinned(points, SEARCH_POINTS), poses))


def search(field: LikelihoodField, points: Floats, prediction: se2.Pose) -> tuple[se2.Pose, float]:
    """The pose around the prediction at which a scan's points (p, 2) lie best on those of the last keyframes, and how
    well (0 to 1), to the steps of the search."""
    offsets = np.arange(-SEARCH_HALF_WIDTH, SEARCH_HALF_WIDTH + 1e-9, SEARCH_STEP)
    turns = np.arange(-SEARCH_HALF_TURN, SEARCH_HALF_TURN + 1e-9, SEARCH_TURN_STEP)
    grid = np.stack(np.meshgrid(offsets, offsets, turns, indexing="ij"), axis=-1).reshape(-1, 3)
    poses = prediction + grid
    scores = likelihood_scores(field, points, poses)
    best = int(np.argmax(scores))
    return poses[best], float(scores[best])


@njit(cache=True)
def _likelihood_scores(squared, origin, points, poses):  # type: ignore[no-untyped-def]
    scores = np.zeros(len(poses))
    cells = len(squared)
    for index in range(len(poses)):
        c, s = math.cos(poses[index, 2]), math.sin(poses[index, 2])
        x0, y0 = poses[index, 0] - origin[0], poses[index, 1] - origin[1]
        total = 0.0
        for p in range(len(points)):
            x, y = x0 + c * points[p, 0] - s * points[p, 1], y0 + s * points[p, 0] + c * points[p, 1]
            i, j = int(x / CELL), int(y / CELL)
            if x > 0.0 and y > 0.0 and i < cells and j < cells and squared[i, j] < RADIUS * RADIUS:
                total += math.exp(-squared[i, j] / (2 * SEARCH_SIGMA * SEARCH_SIGMA))
        scores[index] = total / max(1, len(points))
    return scores
