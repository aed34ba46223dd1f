"""A known map with the points of its scans, and a drive in submaps that is searched for in it.

Points are grouped by square cells. A cell is the unit of evidence: its points lie on one object or on one stretch of
wall, and fit another map together or not at all. Points on long walls are a cell, and the others in the square are
another one: what stands at a wall changes without the wall.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.compiled import compiled
from drivers.immutable import immutable

from ..geometry.segments import Floats, Integers
from ..geometry.surroundings import BUILDING_SIZE, DOOR_WIDTH
from ..localisation.local_field import LocalField
from ..loop_closure.submap_search import DISTORTION_SIGMAS, REVISIT_GAP, build_submap
from ..mapping.mapper import Mapper
from ..matching.distance_field import DistanceField
from ..matching.free_space import SEEN_CELL
from ..matching.offset_tiles import MAX_DISTANCE
from ..matching.point_costs import MISFIT, NEW_SURFACE_COST, point_cost
from ..matching.scan_points import COLUMNS, lines_of
from .crossed_space import CrossedSpace, is_crossed
from .map_descriptor import MapDescriptor
from .map_index import MapIndex, index_map
from .points_at_rest import points_at_rest

# Metres, side of a cell: the width of a door, or of a piece of furniture. Origin: definition; with 2 m the walls of
# a single room are too few cells to decide by.
EVIDENCE_CELL = DOOR_WIDTH
# Metres of a wall that is not a piece of furniture. Origin: chosen, longer than usual tables and cupboards.
MIN_WALL_LENGTH = 3.0
# Metres from the median position along x and y up to which a map is searched: memory grows with the square, and one
# keyframe may be far away after a failure of odometry. Origin: definition.
MAX_REACH = BUILDING_SIZE


@immutable
class CellPoints:
    """Points (p, 6) with normals, in the order of the numbers (p,) of the cells of the map in which they lie.

    Numbers of cells on long walls are odd, see `are_on_walls`.
    """

    points: Floats
    cells: Integers

    def near(self, position: Floats, distance: float) -> CellPoints:
        """Return the points up to a distance (metres) from a position (2,)."""
        near = np.hypot(self.points[:, 0] - position[0], self.points[:, 1] - position[1]) < distance
        return CellPoints(np.ascontiguousarray(self.points[near]), self.cells[near])

    def add_misfits(self, other: ScannedMap | SubmapScan, pose: se2.Pose, misfits: Floats, known: Floats) -> None:
        """Add to `known` (c,) the points of each cell that another map can judge, to `misfits` those that misfit.

        The points are moved by `pose`; a point can misfit in part. See `slam.matching.point_costs`.
        """
        _add_misfits(other.field.arrays, other.crossed.arrays, self.points, self.cells, pose, misfits, known)


@immutable
class ScannedMap:
    """Known map with the points of its keyframes, in which a drive is searched for.

    index   its walls
    field   distance field of all points
    crossed  space that beams crossed
    points  at rest, thinned, in the map's frame
    cells   number of cells
    """

    index: MapIndex
    field: DistanceField
    crossed: CrossedSpace
    points: CellPoints
    cells: int

    @property
    def seen_area(self) -> float:
        """Square metres that scans have seen."""
        return float(np.count_nonzero(self.field.seen)) * SEEN_CELL**2


@immutable
class SubmapScan:
    """Submap of a drive with the points of its scans, in the frame of its last keyframe.

    keyframes   of the submap
    descriptor  its walls
    points      (p, 6) at rest, thinned, with normals
    field       distance field of all points
    crossed     space that beams crossed
    reach       metres from the last keyframe to the farthest point, at most MAX_REACH
    """

    keyframes: range
    descriptor: MapDescriptor
    points: Floats
    field: DistanceField
    crossed: CrossedSpace
    reach: float


@immutable
class DriveSubmap:
    """Submap in its own drive's map.

    scan    the submap
    pose    (3,) of its last keyframe in the drive's map
    points  in the submap's frame; the cells are those of the drive's map
    """

    scan: SubmapScan
    pose: se2.Pose
    points: CellPoints


@immutable
class ScannedDrive:
    """Drive in submaps that are searched for in a known map.

    submaps    in the order of driving
    cells      number of cells of the drive's map
    relations  pose of the second submap of a pair in the frame of the first, and its covariance (3, 3) in its own frame
    """

    submaps: Sequence[DriveSubmap]
    cells: int
    relations: Mapping[tuple[int, int], tuple[se2.Pose, Floats]]


def scan_map(
    index: MapIndex, poses: Floats, points: Sequence[NDArray[np.floating]], cell: float = EVIDENCE_CELL
) -> ScannedMap:
    """Prepare a map of keyframes at `poses` (k, 3), each with points (p, 6) with normals in its frame, to search in.

    cell  metres, side of its cells

    What is farther than MAX_REACH from the middle of the keyframes is not searched.
    """
    moved = np.concatenate(
        [np.zeros((0, COLUMNS)), *(_transform(pose, own) for pose, own in zip(poses, points, strict=True))]
    )
    low, high = _bounds(moved if len(moved) else poses, poses)
    field = DistanceField.empty(0.5 * (low + high), 0.5 * float((high - low).max()) + MAX_DISTANCE)
    field.insert_scans(poses, points)
    grid = _CellGrid.of(low, high, cell)
    beams = _beams(poses, points, moved, low, high)
    kept, crossed = points_at_rest(*beams), CrossedSpace.of_beams(beams[0], beams[1][:, :2])
    return ScannedMap(index, field, crossed, grid.sort(kept, np.zeros(3), index.descriptor), grid.count)


def scan_keyframes(mapper: Mapper, local_field: LocalField, chosen: NDArray[np.bool_]) -> ScannedMap:
    """Prepare the map of the keyframes `chosen` (k,) to search in."""
    rows = np.flatnonzero(chosen)
    return scan_map(index_map(mapper, chosen), mapper.keyframe_poses[rows], local_field.points_of(rows))


def scan_submap(
    keyframes: range, descriptor: MapDescriptor, poses: Floats, points: Sequence[NDArray[np.floating]]
) -> SubmapScan:
    """Build a submap of keyframes at `poses` (k, 3), each with points (p, 6) with normals in its frame.

    descriptor  walls in the frame of the last keyframe
    """
    relative = se2.between(poses[-1], poses).reshape(-1, 3)
    farthest = [np.hypot(own[:, 0], own[:, 1]).max(initial=0.0) for own in points]
    reach = min(MAX_REACH, float(np.max(np.hypot(relative[:, 0], relative[:, 1]) + farthest)))
    built = build_submap(relative, points, reach + MAX_DISTANCE)
    beams = _beams(relative, points, built.points, np.full(2, -reach), np.full(2, reach))
    kept, crossed = points_at_rest(*beams), CrossedSpace.of_beams(beams[0], beams[1][:, :2])
    return SubmapScan(keyframes, descriptor, kept, built.field, crossed, reach)


def scan_drive(mapper: Mapper, scans: Sequence[SubmapScan], cell: float = EVIDENCE_CELL) -> ScannedDrive:
    """Return a drive with its submaps at their present poses in the map; `cell` is the side of its cells, metres."""
    poses = np.array([mapper.keyframe_poses[scan.keyframes[-1]] for scan in scans])
    moved = [_transform(pose, scan.points)[:, :2] for pose, scan in zip(poses, scans, strict=True)]
    grid = _CellGrid.of(*_bounds(np.concatenate([poses[:, :2], *moved]), poses), cell)
    placed = [
        DriveSubmap(scan, pose, grid.sort(scan.points, pose, scan.descriptor))
        for scan, pose in zip(scans, poses, strict=True)
    ]
    return ScannedDrive(placed, grid.count, _relations(mapper, placed))


def are_on_walls(count: int) -> NDArray[np.bool_]:
    """Return (count,) which of the cells of a map, by their numbers, have the points on long walls."""
    return np.asarray(np.arange(count) % 2 == 1)


def _beams(
    poses: Floats, points: Sequence[NDArray[np.floating]], moved: Floats, low: Floats, high: Floats
) -> tuple[Floats, Floats]:
    """Return starts (p, 2) and points (p, 6) of beams that end between two corners (2,).

    points, moved  those seen from each of `poses` (k, 3) in its frame, and all of them in the frame of the poses
    """
    starts = np.repeat(poses[:, :2], [len(own) for own in points], axis=0)
    inside = np.all((moved[:, :2] >= low) & (moved[:, :2] <= high), axis=1)
    return starts[inside], moved[inside]


@immutable
class _CellGrid:
    """Squares of a map: lower corner (2,) of the first one, their number along x and y (2,), and their side, metres."""

    origin: Floats
    shape: Integers
    side: float

    @classmethod
    def of(cls, low: Floats, high: Floats, side: float) -> _CellGrid:
        """Return the squares of the points between two corners (2,); they stay the same if the map grows."""
        origin = np.floor(low / side) * side
        return cls(origin, np.floor((high - origin) / side).astype(np.int64) + 1, side)

    @property
    def count(self) -> int:
        """Number of cells, two for each square."""
        return 2 * int(self.shape.prod())

    def sort(self, points: Floats, pose: se2.Pose, walls: MapDescriptor) -> CellPoints:
        """Return points (p, 6) in a frame at `pose` in the map, in the order of their cells; `walls` in the frame."""
        squares = np.floor((_transform(pose, points)[:, :2] - self.origin) / self.side).astype(np.int64)
        squares = np.clip(squares, 0, self.shape - 1)
        long = 2.0 * walls.half_length > MIN_WALL_LENGTH
        on_wall = lines_of(points, walls.frame[long], walls.half_length[long]) >= 0
        numbers = 2 * (squares[:, 0] * self.shape[1] + squares[:, 1]) + on_wall
        order = np.argsort(numbers, kind="stable")
        return CellPoints(np.ascontiguousarray(points[order]), numbers[order])


def _bounds(points: Floats, poses: Floats) -> tuple[Floats, Floats]:
    """Return the lower and the upper corner (2,) around some points or poses (n, m).

    Both are at most MAX_REACH from the median of `poses` (k, 3).
    """
    middle = np.median(poses[:, :2], axis=0)
    low, high = np.maximum(points[:, :2].min(axis=0), middle - MAX_REACH), points[:, :2].max(axis=0)
    return low, np.maximum(low, np.minimum(high, middle + MAX_REACH))


def _relations(mapper: Mapper, submaps: Sequence[DriveSubmap]) -> dict[tuple[int, int], tuple[se2.Pose, Floats]]:
    """Return the relative poses of submaps with the one before and the nearest earlier one, in both directions.

    The latter counts if it is nearer than REVISIT_GAP: passes of one place are connected, as by closed loops.
    """
    relations = {}
    for j in range(1, len(submaps)):
        distances = [math.hypot(*se2.between(one.pose, submaps[j].pose)[:2]) for one in submaps[: j - 1]]
        near = {int(np.argmin(distances))} if distances and min(distances) < REVISIT_GAP else set()
        for i in sorted(near | {j - 1}):
            one, other = submaps[i], submaps[j]
            relative = se2.between(one.pose, other.pose)
            covariance = mapper.covariances.relative(one.scan.keyframes[-1], other.scan.keyframes[-1])
            covariance = covariance + np.diag(DISTORTION_SIGMAS**2)
            adjoint = se2.adjoint(relative)
            relations[i, j] = relative, covariance
            relations[j, i] = se2.inverse(relative), adjoint @ covariance @ adjoint.T
    return relations


def _transform(pose: se2.Pose, points: NDArray[np.floating]) -> Floats:
    """Transform points (p, 6) with normals."""
    turn = np.array([0.0, 0.0, pose[2]])
    moved, normals = se2.transform(pose, points[:, :2]), se2.transform(turn, points[:, 2:4])
    return np.column_stack([moved.reshape(-1, 2), normals.reshape(-1, 2), points[:, 4:]]).astype(np.float64)


@compiled
def _add_misfits(field, crossed, points, cells, pose, misfits, known):  # type: ignore[no-untyped-def]
    """Add the points of each cell; see `CellPoints.add_misfits`. A misfit is a cost as a share of MISFIT."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for k in range(len(points)):
        cost, evidence = point_cost(field, points, k, pose, c, s)
        if cost > NEW_SURFACE_COST:
            x, y = points[k, 0], points[k, 1]
            evidence = evidence and is_crossed(crossed, pose[0] + c * x - s * y, pose[1] + s * x + c * y)
        if evidence:
            misfits[cells[k]] += cost / MISFIT
            known[cells[k]] += 1.0
