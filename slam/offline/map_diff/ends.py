"""Ends of walls as scans have seen them: beside a beam that ends on the wall, the next one passes its line.

An end that a scan shows lies between the places where both beams cross the wall's line.
The ends of a landmark may be others: the limit of what was seen, or of what something hides.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.immutable import immutable

from ...geometry.normal_distribution import NORMAL_SCALE
from ...geometry.segments import Floats, Integers
from ...mapping.map_features import MapWalls
from ...mapping.sight_lines import MIN_DEPTH
from ...mapping.wall_cells import ON_WALL_DISTANCE, WALL_CELL
from .surveys import Survey

# Scans that must show an end: two have a scatter, but none that means anything. Origin: definition.
MIN_SCANS = 3
# Metres beyond the extent of a wall within which its ends are searched for: as far as ends are compared.
# Origin: definition, as MAX_SHIFT of changes.
REACH = 0.5
# Metres between the places beside an end: beams farther apart do not show it. Origin: chosen, two cells; not measured.
MAX_WIDTH = 2.0 * WALL_CELL
# Information per square metre and per square radian that a scan without walls has about its pose, to be invertible.
# Origin: numerical, a standard deviation of 100 m and of 100 rad.
LEAST_INFORMATION = 1e-4


@immutable
class WallEnd:
    """End of a wall.

    wall      row of the wall
    along     metres from its frame
    side      1 if the wall is at smaller distances along, -1 if it is at larger ones
    scans     number of scans that show the end
    scatter   variance of `along` by the scatter of these scans, square metres
    pose      variance of `along` by the noise of the scans' poses relative to the walls, square metres
    gradient  (2 n,) of `along` by offsets and headings of all walls, which determine the poses of the scans
    """

    wall: int
    along: float
    side: int
    scans: int
    scatter: float
    pose: float
    gradient: Floats


@immutable
class WallsOfScan:
    """What the p beams of a scan show of w walls.

    rows    (w,) of the walls that the scan is in front of
    eye     (w,) metres of the viewpoint along each wall
    across  (w, p) metres of the points from the wall's line, towards the side that it is seen from
    place   (w, p) metres along the wall of where beams that end on or behind it cross its line; of the other points
    on      (w, p) true for points on the wall
    through (w, p) true for beams that end clearly behind it
    """

    rows: Integers
    eye: Floats
    across: Floats
    place: Floats
    on: NDArray[np.bool_]
    through: NDArray[np.bool_]


def walls_of_scan(walls: MapWalls, pose: se2.Pose, points: Floats, chosen: Integers | None = None) -> WallsOfScan:
    """Return what a scan with points (p, 2), in the frame of its pose in the map, shows of the walls it is in front of.

    chosen  rows of the walls that are considered; if None, all

    Beams count up to REACH beyond the observed extent of a wall.
    """
    number = np.arange(len(walls)) if chosen is None else chosen
    eye = se2.between(walls.frame[number], pose).reshape(-1, 3)
    low, high = walls.low[number], walls.high[number]
    beyond = np.maximum(np.maximum(low - eye[:, 0], eye[:, 0] - high), 0.0)
    reach = float(np.hypot(points[:, 0], points[:, 1]).max(initial=0.0))
    rows = np.flatnonzero((eye[:, 1] >= MIN_DEPTH) & (np.hypot(beyond, eye[:, 1]) < reach))
    eye = eye[rows]
    cosine, sine = np.cos(eye[:, 2])[:, None], np.sin(eye[:, 2])[:, None]
    ahead, rise = cosine * points[:, 0] - sine * points[:, 1], sine * points[:, 0] + cosine * points[:, 1]
    across = eye[:, 1:2] + rise
    on, through = np.abs(across) < ON_WALL_DISTANCE, across < -MIN_DEPTH
    crosses = on | through  # the noise of a range is mostly along the wall if it is seen at a small angle
    share = np.where(crosses, -eye[:, 1:2] / np.where(crosses, rise, 1.0), 1.0)
    place = eye[:, :1] + share * ahead
    near = (place > low[rows][:, None] - REACH) & (place < high[rows][:, None] + REACH)
    return WallsOfScan(number[rows], eye[:, 0], across, place, on & near, through & near)


def find_ends(survey: Survey, chosen: Integers) -> list[WallEnd]:
    """Return the ends of some walls of a survey, `chosen` (k,) rows, that at least MIN_SCANS of its scans show."""
    walls = survey.wall_map.walls
    wanted = np.zeros(len(walls), dtype=bool)
    wanted[chosen] = True
    sightings, dependences = [np.zeros((0, 5))], dict[int, _PoseDependence]()
    for scan, (pose, points) in enumerate(zip(survey.poses, survey.points, strict=True)):
        seen = walls_of_scan(walls, pose, points)
        edges = [rows for rows in _edges(seen, wanted[seen.rows]) if len(rows)]
        if edges:
            sightings += [np.column_stack([np.full(len(rows), scan), rows]) for rows in edges]
            dependences[scan] = _pose_dependence(walls, pose, points, seen)
    found = np.concatenate(sightings)
    ends = []
    for wall in chosen.tolist():
        for side in (-1, 1):
            rows = found[(found[:, 1] == wall) & (found[:, 2] == side)]
            ends += [_end(survey, dependences, group) for group in _groups(rows)]
    return ends


def _edges(seen: WallsOfScan, wanted: NDArray[np.bool_]) -> Iterator[Floats]:
    """Yield rows (k, 4) for the ends that one scan shows: wall, side, and the places between which the end lies.

    The scan must look along the wall towards its end: from the other side it also sees the jamb, past which beams cross
    the wall's line at some distance from the end.
    """
    for here, beside in ((slice(None, -1), slice(1, None)), (slice(1, None), slice(None, -1))):
        wall, beam = np.nonzero(seen.on[:, here] & seen.through[:, beside] & wanted[:, None])
        near, far = seen.place[:, here][wall, beam], seen.place[:, beside][wall, beam]
        side = np.where(far > near, 1, -1)
        usable = (np.abs(far - near) <= MAX_WIDTH) & (side * (near - seen.eye[wall]) > 0.0)
        yield np.column_stack([seen.rows[wall], side, near, far])[usable]


def _groups(rows: Floats) -> Iterator[Floats]:
    """Yield the sightings (k, 5) of each end: scan, wall, side and both places; one per scan."""
    if not len(rows):
        return
    middle, width = rows[:, 3:].mean(axis=1), np.abs(rows[:, 4] - rows[:, 3])
    order = np.argsort(middle, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(middle[order]) > WALL_CELL) + 1):
        narrowest = part[np.lexsort((width[part], rows[part, 0]))]
        narrowest = narrowest[np.unique(rows[narrowest, 0], return_index=True)[1]]
        if len(narrowest) >= MIN_SCANS:
            yield rows[narrowest]


def _end(survey: Survey, dependences: Mapping[int, _PoseDependence], sightings: Floats) -> WallEnd:
    """Return an end from its sightings (k, 5), weighted by the distance between the beams beside it."""
    wall, side = sightings[0, 1:3].astype(int).tolist()
    middle, width = sightings[:, 3:].mean(axis=1), sightings[:, 4] - sightings[:, 3]
    resolution = width**2 / 12.0  # variance of the uniform distribution
    weight = 1.0 / np.maximum(resolution, np.median(resolution))
    weight /= weight.sum()
    along = float(weight @ middle)
    squared = float(weight @ weight)
    scatter = max(float(weight @ (middle - along) ** 2) * squared / (1.0 - squared), float(weight**2 @ resolution))
    point, normal = survey.wall_map.point(wall, along), survey.wall_map.normal(wall)
    gradient, variance = np.zeros(2 * len(survey.wall_map.walls)), 0.0
    for share, scan in zip(weight.tolist(), sightings[:, 0].astype(int).tolist(), strict=True):
        lever = point - survey.poses[scan, :2]
        shift = np.array([normal[1], -normal[0], lever @ normal])  # of the point along the wall, by the pose
        gradient += share * (shift @ dependences[scan].by_walls)
        variance += share * float(shift @ dependences[scan].noise @ shift)
    return WallEnd(wall, along, side, len(sightings), scatter, variance, gradient)


@immutable
class _PoseDependence:
    """How the pose of a scan follows from the walls that it shows.

    by_walls  (3, 2 n) derivative of the pose in the map by offsets and headings of all walls
    noise     (3, 3) covariance by the noise of the points
    """

    by_walls: Floats
    noise: Floats


def _pose_dependence(walls: MapWalls, pose: se2.Pose, points: Floats, seen: WallsOfScan) -> _PoseDependence:
    """Return how the pose of a scan with points (p, 2) follows from the walls.

    The points fit the walls best: J d = L w by least squares, with the change d of the pose, the changes w of the
    walls, the normals J and the levers L of the points.
    """
    row, beam = np.nonzero(seen.on)
    if not len(row):
        return _PoseDependence(np.zeros((3, 2 * len(walls))), np.eye(3) / LEAST_INFORMATION)
    wall = seen.rows[row]
    heading = walls.frame[wall, 2]
    normal = np.column_stack([-np.sin(heading), np.cos(heading)])
    places = np.asarray(se2.transform(pose, points[beam])) - pose[:2]
    jacobian = np.column_stack([normal, places[:, 0] * normal[:, 1] - places[:, 1] * normal[:, 0]])
    inverse = np.linalg.inv(jacobian.T @ jacobian + LEAST_INFORMATION * np.eye(3))
    by_points = inverse @ jacobian.T
    by_walls = np.zeros((2 * len(walls), 3))
    np.add.at(by_walls, 2 * wall, by_points.T)
    np.add.at(by_walls, 2 * wall + 1, (by_points * seen.place[row, beam]).T)
    noise = NORMAL_SCALE * float(np.median(np.abs(seen.across[row, beam])))
    return _PoseDependence(by_walls.T, noise**2 * inverse)
