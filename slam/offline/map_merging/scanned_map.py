"""Map of a session with the points of its scans, as a whole and in submaps, as input of the search for placements.

Points are grouped by square cells of the map. A cell is the unit of evidence: its points lie on one object or on one
stretch of wall, and fit another map together or not at all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from drivers import se2
from drivers.compiled import compiled

from ...estimation.refinement.scan_history import ScanHistory
from ...geometry.segments import Floats, Integers
from ...io.sessions import StoredSession
from ...loop_closure.map_descriptor import MapDescriptor, express_in_frame
from ...loop_closure.relocalisation import MapIndex, index_map
from ...loop_closure.submap_search import DISTORTION_SIGMAS, build_submap
from ...mapping.mapper import Mapper
from ...matching.distance_field import DistanceField
from ...matching.free_space import SEEN_CELL
from ...matching.point_costs import points_cost
from ...matching.point_matcher import POINT_SPACING
from ...matching.scan_points import surface_points
from .submaps import split_into_submaps

EVIDENCE_CELL = 2.0
"""Metres, side of a cell of the map: the size of a door with its jambs, or of a piece of furniture."""
THINNED_SPACING = 0.1
"""Metres between points that are kept of each surface, so that evidence does not depend on how often it was seen."""
FIELD_MARGIN = 2.0
"""Metres from the outermost point to the border of a distance field."""
MAX_RELATION_DISTANCE = 10.0
"""Metres up to which the nearest earlier submap counts: passes of one place are connected, as by closed loops."""


@dataclass(frozen=True, slots=True, eq=False)
class CellPoints:
    """Points (p, 4) with normals, in the order of the numbers (p,) of the cells of the map in which they lie."""

    points: Floats
    cells: Integers

    def near(self, position: Floats, distance: float) -> CellPoints:
        """Return the points up to a distance (metres) from a position (2,)."""
        near = np.hypot(self.points[:, 0] - position[0], self.points[:, 1] - position[1]) < distance
        return CellPoints(np.ascontiguousarray(self.points[near]), self.cells[near])

    def add_misfits(self, field: DistanceField, pose: se2.Pose, misfits: Floats, known: Floats) -> None:
        """Add to `known` (c,) the points of each cell in space that a field has seen, to `misfits` those that misfit.

        The points are moved by `pose`; a point can misfit in part. See `slam.matching.point_costs`.
        """
        _add_misfits(field.arrays, self.points, self.cells, pose, misfits, known)


@dataclass(frozen=True, slots=True, eq=False)
class ScannedSubmap:
    """Submap of a session with the points of its scans; its frame is that of its last keyframe.

    keyframes   of the submap
    pose        (3,) of the last one in its own session's map
    descriptor  its walls and corners
    points      thinned; the cells are those of the session's map
    field       distance field of all points
    reach       metres from the last keyframe to the farthest point
    """

    keyframes: range
    pose: se2.Pose
    descriptor: MapDescriptor
    points: CellPoints
    field: DistanceField
    reach: float


@dataclass(frozen=True, slots=True, eq=False)
class ScannedMap:
    """Map of a session with the points of its keyframes.

    index      its walls, for the search
    field      distance field of all points
    points     thinned, in the map's frame
    cells      number of cells
    submaps    in the order of driving
    relations  pose of the second submap of a pair in the frame of the first, and its covariance (3, 3) in its own frame
    """

    index: MapIndex
    field: DistanceField
    points: CellPoints
    cells: int
    submaps: Sequence[ScannedSubmap]
    relations: Mapping[tuple[int, int], tuple[se2.Pose, Floats]]

    @property
    def seen_area(self) -> float:
        """Square metres that scans have seen."""
        return float(np.count_nonzero(self.field.seen)) * SEEN_CELL**2


def scan_map(session: StoredSession) -> ScannedMap:
    """Prepare a session that has keyframes: as a map to search in, and as submaps that are searched for."""
    mapper, history = session.slam_state.mapper, session.scan_history()
    poses = mapper.keyframe_poses
    points = _keyframe_points(history)
    moved = np.concatenate([_transform(pose, own) for pose, own in zip(poses, points, strict=True)])
    low, high = moved[:, :2].min(axis=0, initial=np.inf), moved[:, :2].max(axis=0, initial=-np.inf)
    if not len(moved):
        low, high = poses[:, :2].min(axis=0), poses[:, :2].max(axis=0)
    grid = _CellGrid(low, np.floor((high - low) / EVIDENCE_CELL).astype(np.int64) + 1)
    field = DistanceField.empty(0.5 * (low + high), 0.5 * float((high - low).max()) + FIELD_MARGIN)
    field.insert_scans(poses, points)
    submaps = []
    for keyframes, submap in split_into_submaps(mapper, history):
        own = slice(keyframes.start, keyframes.stop)
        descriptor = express_in_frame(submap.pose, submap.descriptor)
        submaps.append(_scan_submap(keyframes, submap.pose, descriptor, poses[own], points[own], grid))
    return ScannedMap(
        index_map(mapper),
        field,
        grid.sort(moved, np.zeros(3)),
        int(grid.shape.prod()),
        submaps,
        _relations(mapper, submaps),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _CellGrid:
    """Cells of a map: lower corner (2,) of the first one, and their number along x and y (2,)."""

    origin: Floats
    shape: Integers

    def sort(self, points: Floats, pose: se2.Pose) -> CellPoints:
        """Return points in a frame at `pose` in the map, thinned and in the order of their cells."""
        thinned = _thin(points)
        cells = np.floor((_transform(pose, thinned)[:, :2] - self.origin) / EVIDENCE_CELL).astype(np.int64)
        cells = np.clip(cells, 0, self.shape - 1)
        numbers = cells[:, 0] * self.shape[1] + cells[:, 1]
        order = np.argsort(numbers, kind="stable")
        return CellPoints(np.ascontiguousarray(thinned[order]), numbers[order])


def _keyframe_points(history: ScanHistory) -> list[Floats]:
    """Return the points (p, 4) of each keyframe with their normals, in its frame."""
    features = [history.scans[row].features for row in history.keyframes]
    return [surface_points(some.points.xy, some.segments, POINT_SPACING) for some in features]


def _scan_submap(
    keyframes: range,
    pose: se2.Pose,
    descriptor: MapDescriptor,
    poses: Floats,
    points: Sequence[Floats],
    grid: _CellGrid,
) -> ScannedSubmap:
    """Build a submap with its frame at `pose` of keyframes at `poses` (k, 3) in the map, with their points."""
    relative = se2.between(pose, poses).reshape(-1, 3)
    farthest = [np.hypot(own[:, 0], own[:, 1]).max(initial=0.0) for own in points]
    reach = float(np.max(np.hypot(relative[:, 0], relative[:, 1]) + farthest))
    built = build_submap(relative, points, reach + FIELD_MARGIN)
    return ScannedSubmap(keyframes, pose, descriptor, grid.sort(built.points, pose), built.field, reach)


def _relations(mapper: Mapper, submaps: Sequence[ScannedSubmap]) -> dict[tuple[int, int], tuple[se2.Pose, Floats]]:
    """Return the relative poses of submaps with the one before and the nearest earlier one, in both directions."""
    relations = {}
    for j in range(1, len(submaps)):
        distances = [math.hypot(*se2.between(one.pose, submaps[j].pose)[:2]) for one in submaps[: j - 1]]
        near = {int(np.argmin(distances))} if distances and min(distances) < MAX_RELATION_DISTANCE else set()
        for i in sorted(near | {j - 1}):
            one = submaps[i]
            relative = se2.between(one.pose, submaps[j].pose)
            covariance = mapper.covariances.relative(one.keyframes[-1], submaps[j].keyframes[-1])
            covariance = covariance + np.diag(DISTORTION_SIGMAS**2)
            adjoint = se2.adjoint(relative)
            relations[i, j] = relative, covariance
            relations[j, i] = se2.inverse(relative), adjoint @ covariance @ adjoint.T
    return relations


def _transform(pose: se2.Pose, points: Floats) -> Floats:
    """Transform points (p, 4) with normals."""
    turn = np.array([0.0, 0.0, pose[2]])
    moved, normals = se2.transform(pose, points[:, :2]), se2.transform(turn, points[:, 2:])
    return np.column_stack([moved.reshape(-1, 2), normals.reshape(-1, 2)])


def _thin(points: Floats) -> Floats:
    """Return one of the points (p, 4) of each square of THINNED_SPACING whose surfaces face in about one direction."""
    squares = np.round(points[:, :2] / THINNED_SPACING).astype(np.int64)
    facing = np.round(np.arctan2(points[:, 3], points[:, 2]) / (0.5 * math.pi)).astype(np.int64) % 4
    facing[~points[:, 2:].any(axis=1)] = 4
    _, first = np.unique(np.column_stack([squares, facing]), axis=0, return_index=True)
    return np.ascontiguousarray(points[np.sort(first)])


@compiled
def _add_misfits(field, points, cells, pose, misfits, known):  # type: ignore[no-untyped-def]
    """Add the points of each cell; see `CellPoints.add_misfits`."""
    first = 0
    while first < len(points):
        end = first
        while end < len(points) and cells[end] == cells[first]:
            end += 1
        _, fit, count = points_cost(field, points[first:end], pose)
        misfits[cells[first]] += (1.0 - fit) * count
        known[cells[first]] += count
        first = end
