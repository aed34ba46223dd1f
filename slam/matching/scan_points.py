"""Points of one scan, the normals of their surfaces, and the segments on which they lie."""

from __future__ import annotations

import math

import numpy as np

from drivers.compiled import compiled

from ..geometry.angles import axes_of
from ..geometry.median import median
from ..geometry.normal_distribution import NORMAL_MEDIAN
from ..geometry.segments import Floats, Integers, Segments
from ..geometry.surroundings import MIN_WALL_LENGTH, SURFACE_DEPTH

# Points of one scan that are kept; denser scans are subsampled. Origin: chosen, above the 361 beams of a half-circle
# lidar with half-degree steps: a limit of 360 left out every other of them.
MAX_SCAN_POINTS = 400

# Metres: resolution of points, a small part of any lidar's noise. Sessions store them as multiples of it, so that a run
# that is continued from a session equals one that was not interrupted. Origin: definition.
POINT_UNIT = 1e-3
# Largest coordinate in these units. Origin: definition, 2 km, beyond the range of any lidar.
MAX_POINT_UNITS = 2e6

# Metres, standard deviation of a matched point, and scale of the narrow kernel. Origin: measured, on ten recordings:
# 0.03 agrees best among 0.03, 0.05 and 0.10 on eight of them.
FINE_SIGMA = 0.03

# Metres between a point and the line of a segment on which it lies. Origin: definition.
LINE_DISTANCE = SURFACE_DEPTH
# Half lengths of a segment, from its middle, up to which points are on its line.
# Origin: chosen, the segment's length beyond either end; not measured.
CONTINUATION = 3.0
# Neighbours on each side to which a line is fitted. Origin: chosen; not measured.
NORMAL_NEIGHBOURS = 4
# Metres within which they must be. Origin: definition.
NORMAL_RADIUS = MIN_WALL_LENGTH
# Points that a line needs. Origin: chosen, two more than determine it.
MIN_NORMAL_POINTS = 4
# Largest variance of the points across a line, as a share of that along it; and largest variance of the direction of a
# line through noisy points, radians squared. Origin: chosen, a seventh in standard deviations; not measured.
MAX_FLATNESS = 0.02
# Largest variance of the points across a line, relative to that across the walls of the scan. Origin: chi-square, the
# sum of squares of 2 to 7 normal deviates, divided by the 4 to 9 points, is below it in 99.7 %.
MAX_SCATTER = 3.0


# Column of the weight of a matched point, and number of columns; see `surface_points`. Origin: definition.
WEIGHT, COLUMNS = 5, 6


class ScanPoints:
    """Points of one scan in the base's frame.

    sigma  metres: standard deviation of a range by the noise of the lidar, as learned from earlier scans; 0 if unknown

    They are stored as multiples of POINT_UNIT to save memory: all scans of a drive are kept, and most of the memory of
    a scan is that of its points.
    """

    __slots__ = ("_units", "sigma")

    def __init__(self, xy: Floats, sigma: float = 0.0) -> None:
        """Round points (p, 2), metres. Coordinates beyond MAX_POINT_UNITS are clipped."""
        self.sigma = float(np.float32(sigma))  # as sessions store it
        self._units = _in_units(np.ascontiguousarray(xy))  # strided ones would be compiled for separately

    @property
    def xy(self) -> Floats:
        """Points (p, 2), metres."""
        return np.asarray(POINT_UNIT * self._units, dtype=np.float64)


@compiled
def _in_units(points):  # type: ignore[no-untyped-def]
    """Return points (p, 2) as numbers of POINT_UNIT."""
    counts = np.empty(points.shape, np.int32)
    for k in range(len(points)):
        for axis in range(2):
            counts[k, axis] = min(max(np.rint(points[k, axis] / POINT_UNIT), -MAX_POINT_UNITS), MAX_POINT_UNITS)
    return counts


def subsample(points: Floats, max_count: int) -> Floats:
    """Return every k-th of points (p, d), with the smallest k that leaves at most `max_count`."""
    return points[:: max(1, -(-len(points) // max_count))]


def surface_points(points: Floats, segments: Segments, spacing: float, sigma: float = 0.0) -> Floats:
    """Return (q, 6) the points to be matched, in the base's frame: x, y, normal [x, y], excess, weight.

    points    (p, 2) returns of one scan in the base's frame, in the order of the beams, counter-clockwise
    segments  of the same scan
    spacing   metres; a beam that ends nearer than this to the one kept before hits the same piece of the same surface
              and shares its errors, so it is left out
    sigma     of a range, see `ScanPoints`

    A point on the line of a segment, as far beyond its ends as the segment is long, has the segment's normal: the last
    returns from a corridor's walls move with the robot. Another point has the normal of a line through its neighbours,
    or zero where these are on no line, as at corners and on clutter. They are on a line if they scatter little across
    it compared with along it, or no more than noise explains. That is the scatter of points across the segments of the
    scan, but the fewer of its points are on segments, the more the noise of the lidar, if it is larger. Normals have
    length 1 and point to the lidar: to the left of the direction in which the beams move along the surface, wherever
    the lidar is mounted. All weights are 1.

    The excess is information that a point seems to have, and has not, relative to that of a point along its normal.
    It is zero on segments, and where there are enough neighbours that are on no line. Else:

    - With a normal, it is along the surface. An error of the normal's direction by a small angle e seems to measure the
      position along the surface with e^2 of the information. The mean of e^2 is the variance of the direction of the
      line through n points, their variance across it divided by n - 2 times that along it.
    - With too few neighbours to fit a line, it is in both directions. The surface is known only where beams end, so
      such a point is compared with another piece of its surface, up to half of the gap g between two beams away. As the
      robot moves, the ends of beams slide along smooth surfaces, all in one direction, so that these errors do not
      average out. An error that is uniform up to g / 2 has the variance g^2 / 12. With that of the point itself, s^2,
      the information is s^2 / (s^2 + g^2 / 12) of that of the point, and the rest is excess.
    - All information is excess if the neighbours scatter no more than noise explains, and still show no line.
    """
    points = np.ascontiguousarray(points)  # subsampled ones would be compiled for separately
    return np.asarray(_surface_points(points, segments.frame, segments.half_length, spacing, sigma))


def segments_of(points: Floats, segments: Segments) -> Integers:
    """Return (q,) the row of the segment, between its ends, on which each of `surface_points` (q, 6) lies, or -1."""
    return np.asarray(lines_of(points, segments.frame, segments.half_length))


@compiled
def _surface_points(points, frames, half_lengths, spacing, sigma):  # type: ignore[no-untyped-def]
    kept, rows, count = np.zeros((len(points), COLUMNS)), np.empty(len(points), np.int64), 0
    for k in range(len(points)):
        if count:
            dx, dy = points[k, 0] - kept[count - 1, 0], points[k, 1] - kept[count - 1, 1]
            if dx * dx + dy * dy < spacing * spacing:
                continue
        kept[count, 0], kept[count, 1], kept[count, WEIGHT], rows[count] = points[k, 0], points[k, 1], 1.0, k
        count += 1
    kept, across = kept[:count], np.empty(count)
    axes, lines, found = axes_of(frames), np.empty(count, np.int64), 0
    for k in range(count):
        x, y = kept[k, 0], kept[k, 1]
        lines[k] = line = _nearest_line(x, y, frames, axes, half_lengths, CONTINUATION)
        if line >= 0:
            kept[k, 2], kept[k, 3] = -axes[line, 1], axes[line, 0]
            dx, dy = x - frames[line, 0], y - frames[line, 1]
            if abs(axes[line, 0] * dx + axes[line, 1] * dy) < half_lengths[line]:
                across[found] = (axes[line, 0] * dy - axes[line, 1] * dx) ** 2
                found += 1
    noise = median(across[:found]) / NORMAL_MEDIAN if found else 0.0
    noise += (1.0 - found / max(1, count)) * max(0.0, sigma * sigma - noise)
    for k in range(count):
        if lines[k] < 0 and not _set_normal(kept, k, noise):
            variance = _gap_beside(points, rows[k]) ** 2 / 12.0  # infinite if it is the only return
            kept[k, 4] = 1.0 - FINE_SIGMA**2 / (FINE_SIGMA**2 + variance)
    return kept


@compiled
def _gap_beside(points, k):  # type: ignore[no-untyped-def]
    """Return the distance (metres) from point k of (p, 2) to the nearer one of its two neighbours in order of beams."""
    gap = math.inf
    for j in (k - 1, k + 1):
        if 0 <= j < len(points):
            gap = min(gap, math.hypot(points[j, 0] - points[k, 0], points[j, 1] - points[k, 1]))
    return gap


@compiled
def lines_of(points, frames, half_lengths):  # type: ignore[no-untyped-def]
    """Return (q,) the row of the line, between its ends, on which each of some points (q, ...) lies, or -1.

    frames        (n, 3) in the middles of the lines, x along them
    half_lengths  (n,) metres
    """
    rows, axes = np.empty(len(points), np.int64), axes_of(frames)
    for k in range(len(points)):
        rows[k] = _nearest_line(points[k, 0], points[k, 1], frames, axes, half_lengths, 1.0)
    return rows


@compiled
def _nearest_line(x, y, frames, axes, half_lengths, reach):  # type: ignore[no-untyped-def]
    """Return the row of the nearest line on which (x, y) lies, up to `reach` half lengths from its middle, or -1."""
    nearest, found = LINE_DISTANCE, -1
    for j in range(len(frames)):
        dx, dy = x - frames[j, 0], y - frames[j, 1]
        across = abs(axes[j, 0] * dy - axes[j, 1] * dx)
        if across < nearest and abs(axes[j, 0] * dx + axes[j, 1] * dy) < reach * half_lengths[j]:
            nearest, found = across, j
    return found


@compiled
def _set_normal(points, k, noise):  # type: ignore[no-untyped-def]
    """Set normal and excess of point k of (q, 6) from its neighbours within NORMAL_RADIUS, if they are on a line.

    The line has the direction of the larger eigenvector of the neighbours' covariance. Returns False if there are not
    enough of them to tell. `noise` is the variance of points across a surface by noise.
    """
    n, x, y, xx, xy, yy = 0, 0.0, 0.0, 0.0, 0.0, 0.0
    beams_x, beams_y = 0.0, 0.0  # direction in which the ends of successive beams move along the surface
    for j in range(max(0, k - NORMAL_NEIGHBOURS), min(len(points), k + NORMAL_NEIGHBOURS + 1)):
        dx, dy = points[j, 0] - points[k, 0], points[j, 1] - points[k, 1]
        if dx * dx + dy * dy < NORMAL_RADIUS * NORMAL_RADIUS:
            n, x, y = n + 1, x + dx, y + dy
            xx, xy, yy = xx + dx * dx, xy + dx * dy, yy + dy * dy
            beams_x, beams_y = beams_x + (j - k) * dx, beams_y + (j - k) * dy
    if n < MIN_NORMAL_POINTS:
        return False
    xx, xy, yy = xx / n - (x / n) ** 2, xy / n - x * y / n**2, yy / n - (y / n) ** 2
    half_difference, middle = math.hypot(0.5 * (xx - yy), xy), 0.5 * (xx + yy)
    least, most = middle - half_difference, middle + half_difference
    determined = least < (n - 2) * MAX_FLATNESS * most
    if least < MAX_FLATNESS * most or (least < MAX_SCATTER * noise and determined):
        along = 0.5 * math.atan2(2 * xy, xx - yy)
        c, s = math.cos(along), math.sin(along)
        if c * beams_x + s * beams_y < 0.0:
            c, s = -c, -s
        points[k, 2], points[k, 3], points[k, 4] = -s, c, least / ((n - 2) * most)
    elif least < MAX_SCATTER * noise:
        points[k, 4] = 1.0
    return True
