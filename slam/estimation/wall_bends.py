"""Bends of walls: errors that all observations of a wall share, estimated from the scans at the end of a run.

A real wall is not a straight line, and every view shows the same bends. The line that is fitted to it is therefore
wrong, and no residual shows this error. What a keyframe can see is the deviation of the surface from a line through its
own view, which does not depend on its pose. The products of these deviations at two places, summed over all pairs of
different keyframes, show the variance of the bends and the length over which they are correlated. The covariance of
each wall due to its bends follows from both.

Equations, whose symbols the code uses: docs/mathematics.md#bends-of-walls.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ..geometry.segments import Floats, Integers
from ..graph.wall_bends import BendResponse, WallBends, bend_correlation
from ..mapping.mapper import Mapper
from ..matching.scan_points import LINE_DISTANCE, segments_of
from ..preprocessing.preprocessor import ProcessedScan
from .refinement import ScanHistory

# Metres, correlation lengths of bends that are tried. Origin: numerical, from a door frame to the longest that a view
# of some metres shows, each by three quarters more.
LENGTHS = np.array([0.2, 0.35, 0.6, 1.0])
# Metres along a wall over which the points of a keyframe are averaged. Origin: numerical, half the least of LENGTHS.
CELL = 0.5 * float(LENGTHS[0])
# Metres between two places that are compared, at most. Origin: numerical, C is small beyond twice the longest length.
MAX_DISTANCE = 2.0 * float(LENGTHS[-1])
# Metres of a wall in one view that bends are estimated from. Origin: geometry, a shorter view hardly deviates from its
# own line.
MIN_VIEW = 1.0
# Views of a wall that bends are estimated from, evenly chosen. Origin: numerical, hundreds of pairs for each place.
MAX_VIEWS = 20
# Metres of a wall that are examined together, longer ones in stretches. Origin: numerical, twice MAX_DISTANCE; the time
# grows with the cube.
STRETCH = 2.0 * MAX_DISTANCE
# Keyframes whose points are examined at once. Origin: numerical, so that their arrays take little memory.
CHUNK = 256
# Metres at the ends of segments that are left out: points of the surface around the corner are on the line as well.
# Origin: geometry, for corners of up to 60 degrees from a right angle.
END = 2.0 * LINE_DISTANCE


@immutable
class _Profile:
    """What the keyframes saw of one wall: n cells that any of k keyframes saw.

    wall    landmark id
    place   (n,) metres along the wall from its frame, of the middle of each cell
    seen    (k, n) true where a keyframe saw a cell
    across  (k, n) mean distance of its points from the wall's line, metres; zero where it saw none
    """

    wall: int
    place: Floats
    seen: np.ndarray[tuple[int, int], np.dtype[np.bool_]]
    across: Floats

    @property
    def line(self) -> Floats:
        """Offset and heading of lines at the cells: X (n, 2)."""
        return np.column_stack([np.ones(len(self.place)), self.place])

    @property
    def distance(self) -> Floats:
        """Metres between two cells (n, n)."""
        return np.abs(np.subtract.outer(self.place, self.place))


def settle_wall_bends(mapper: Mapper, history: ScanHistory) -> dict[str, float]:
    """Add the bends of walls to the covariances of a settled map, and return the estimate for the summary."""
    bends = estimate_wall_bends(mapper, [history.scans[row] for row in history.keyframes.tolist()])
    mapper.graph.wall_bends = bends
    return {"sigma": round(bends.sigma, 5), "length": bends.length}


def estimate_wall_bends(mapper: Mapper, scans: Sequence[ProcessedScan]) -> WallBends:
    """Estimate the bends of a settled map's walls; `scans` are those of its keyframes, in their order.

    Scans without points are left out.
    """
    profiles = list(_profiles(mapper, scans))
    variance, length = _fit_process(profiles)
    responses = {}
    for profile in profiles:
        weighted = (profile.line * profile.seen.sum(axis=0)[:, None]).T
        responses[profile.wall] = BendResponse(profile.place, np.linalg.solve(weighted @ profile.line, weighted))
    return WallBends(float(np.sqrt(variance)), float(length), responses)


def _fit_process(profiles: Sequence[_Profile]) -> tuple[float, float]:
    """Return the variance of bends and their correlation length, by least squares over the distances of two places."""
    count = round(MAX_DISTANCE / CELL) + 1
    observed, expected = np.zeros(count), np.zeros((len(LENGTHS), count))
    for profile in _stretches(profiles):
        views = np.flatnonzero(profile.seen.sum(axis=1) >= MIN_VIEW / CELL)
        views = views[:: -(-len(views) // MAX_VIEWS) or 1]
        if len(views) < 2:
            continue
        products, expectations, pairs = _products(profile, views)
        row = np.rint(profile.distance / CELL).astype(np.int64)
        used = (pairs > 0) & (row < count)
        observed += np.bincount(row[used], products[used], minlength=count)
        for of_length, sums in zip(expected, expectations, strict=True):
            of_length += np.bincount(row[used], sums[used], minlength=count)
    squares = np.maximum((expected**2).sum(axis=1), np.finfo(float).tiny)
    variances = np.maximum(expected @ observed / squares, 0.0)
    best = int(np.argmin(((observed - variances[:, None] * expected) ** 2).sum(axis=1)))
    return float(variances[best]), float(LENGTHS[best])


def _stretches(profiles: Sequence[_Profile]) -> Iterator[_Profile]:
    """Yield the walls in stretches of at most STRETCH metres."""
    for profile in profiles:
        stretch = np.floor((profile.place - profile.place[0]) / STRETCH)
        for number in np.unique(stretch):
            cells = stretch == number
            yield _Profile(profile.wall, profile.place[cells], profile.seen[:, cells], profile.across[:, cells])


def _products(profile: _Profile, views: Integers) -> tuple[Floats, Floats, Integers]:
    """Return the sums of products of deviations at each two cells, over all pairs of different views.

    Returns what was seen (n, n), what is expected of bends of unit variance with each of the LENGTHS (l, n, n), and the
    number of pairs (n, n).
    """
    line, seen = profile.line, profile.seen[views]
    correlation = bend_correlation(profile.distance, LENGTHS[:, None, None])
    deviations, operators = np.zeros(seen.shape), np.zeros((len(line), len(line)))
    within = np.zeros_like(correlation)
    for k, view in enumerate(views):
        cells = np.flatnonzero(seen[k])
        axes, _ = np.linalg.qr(line[cells])
        operator = np.eye(len(cells)) - axes @ axes.T
        rows = cells[:, None]
        deviations[k, cells] = operator @ profile.across[view, cells]
        operators[rows, cells] += operator
        within[:, rows, cells] += operator @ correlation[:, rows, cells] @ operator
    total, counts = deviations.sum(axis=0), seen.astype(np.int64)
    pairs = np.outer(counts.sum(axis=0), counts.sum(axis=0)) - counts.T @ counts
    return np.outer(total, total) - deviations.T @ deviations, operators @ correlation @ operators - within, pairs


def _profiles(mapper: Mapper, scans: Sequence[ProcessedScan]) -> Iterator[_Profile]:
    """Yield what the keyframes saw of each wall."""
    walls, keyframes, along, across = _points_on_walls(mapper, scans)
    all_cells = np.floor(along / CELL).astype(np.int64)
    order = np.argsort(walls, kind="stable")
    seen, starts = np.unique(walls[order], return_index=True)
    for wall, rows in zip(seen.tolist(), np.split(order, starts)[1:], strict=True):
        views, view = _distinct(keyframes[rows])
        cells, place = _distinct(all_cells[rows])
        if len(cells) < 2:
            continue
        shape, at = (len(views), len(cells)), view * len(cells) + place
        count = np.bincount(at, minlength=shape[0] * shape[1]).reshape(shape)
        sums = np.bincount(at, across[rows], minlength=shape[0] * shape[1]).reshape(shape)
        mean = np.asarray(sums / np.maximum(count, 1), dtype=np.float64)
        yield _Profile(wall, np.asarray(CELL * (cells + 0.5), dtype=np.float64), count > 0, mean)


def _distinct(values: Integers) -> tuple[Integers, Integers]:
    """Return the distinct ones of values (n,), ascending, and the index (n,) of each value among these.

    `np.unique` sorts; the values here are in a small range.
    """
    low = values.min()
    present = np.bincount(values - low) > 0
    return np.flatnonzero(present) + low, (np.cumsum(present) - 1)[values - low]


def _points_on_walls(mapper: Mapper, scans: Sequence[ProcessedScan]) -> tuple[Integers, Integers, Floats, Floats]:
    """Return the wall, the keyframe, and the metres along the wall and across it, of all points on walls."""
    none = np.zeros(0, dtype=np.int64)
    parts = [
        _points_of_keyframes(mapper, range(first, min(first + CHUNK, len(scans))), scans[first : first + CHUNK])
        for first in range(0, len(scans), CHUNK)
    ]
    walls, keyframes, places = zip((none, none, np.zeros((0, 2))), *parts, strict=True)
    place = np.concatenate(places)
    return np.concatenate(walls), np.concatenate(keyframes), place[:, 0], place[:, 1]


def _points_of_keyframes(
    mapper: Mapper, keyframes: Sequence[int], scans: Sequence[ProcessedScan]
) -> tuple[Integers, Integers, Floats]:
    """Return the wall, the keyframe, and the place (n, 2), along the wall and across it, of points of some keyframes.

    `scans` are those of the keyframes.
    """
    rows = mapper.landmarks.walls.rows
    points = [scan.features.points.xy for scan in scans]
    segment = [segments_of(scan.features.points.xy, scan.features.segments) for scan in scans]
    first = np.cumsum([0, *(len(scan.features.segments) for scan in scans)])[:-1]
    keyframe = np.repeat(keyframes, [len(one) for one in points])
    number = np.concatenate([np.where(one >= 0, one + start, -1) for one, start in zip(segment, first, strict=True)])
    on_segment = np.flatnonzero(number >= 0)
    keyframe, number, point = keyframe[on_segment], number[on_segment], np.concatenate(points)[on_segment]
    walls = np.concatenate([mapper.landmark_ids[k].walls for k in keyframes])[number]
    frame = np.concatenate([scan.features.segments.frame for scan in scans])[number]
    half_length = np.concatenate([scan.features.segments.half_length for scan in scans])[number]
    used = (np.abs(_in_frame(frame, point)[:, 0]) < half_length - END) & (walls >= 0)
    keyframe, wall = keyframe[used], rows["merged_into"][walls[used]]
    in_map = se2.transform(mapper.keyframe_poses[keyframe], point[used])
    return wall, keyframe, _in_frame(rows["frame"][wall], in_map)


def _in_frame(frames: Floats, points: Floats) -> Floats:
    """Return points (n, 2) as seen from frames (n, 3)."""
    c, s = np.cos(frames[:, 2]), np.sin(frames[:, 2])
    x, y = points[:, 0] - frames[:, 0], points[:, 1] - frames[:, 1]
    return np.column_stack([c * x + s * y, c * y - s * x])
