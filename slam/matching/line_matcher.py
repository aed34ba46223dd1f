"""Register a scan: estimate the base's pose in the local map from the scan's segments, corners and other points.

Gauss-Newton with shrinking gates: each step pairs features within the gates anew and solves the normal equations. It
starts where all points of the scan fit best (see `point_matcher`), so that walls are not paired wrongly in turns. Each
point is used once: those on segments that are paired with walls count by these, all others by the distance field.
"""

from __future__ import annotations

import numpy as np

from drivers import se2
from drivers.compiled import compiled, inlined
from drivers.immutable import immutable
from drivers.small_matrices import product, solution

from ..geometry.angles import axes_of
from ..geometry.pose_steps import difference, move_back, wrap_heading
from ..geometry.roughness import Roughness
from ..geometry.segments import Floats
from ..mapping.local_map import LocalMap
from .distance_field import DistanceField
from .interpolation import add_points, memory_for, unbiased_information
from .landmark_equations import CornerArrays, SegmentArrays, WallArrays, add_corners, add_walls
from .offset_tiles import MAX_DISTANCE, MAX_TURN
from .point_costs import points_cost
from .scan_features import ScanFeatures
from .scan_points import COLUMNS, FINE_SIGMA, lines_of

# Metres across a wall between it and a segment, for each Gauss-Newton step; also between two
# corners. Origin: tuned on Intel, fr079, CSAIL.
MATCH_OFFSET_GATES = np.array([0.40, 0.40, 0.30, 0.20, 0.15, 0.10, 0.10, 0.10])
# Radians between a wall and a segment, for each Gauss-Newton step. Origin: tuned on Intel, fr079, CSAIL.
MATCH_HEADING_GATES = np.radians([10.0, 10.0, 9.0, 7.0, 6.0, 5.0, 5.0, 5.0])
# Information (3, 3) that keeps the pose by points alone near the joint one, where the points' distances are linear in
# the pose. Points that determine a direction have far more. Origin: definition.
LINEAR_RANGE_INFORMATION = np.diag(np.array([MAX_DISTANCE, MAX_DISTANCE, MAX_TURN]) ** -2.0)


@immutable
class Registration:
    """Result of registering a scan with the local map.

    pose               [x, y, heading] of the base in the map, from landmarks, points and the prediction
    information        (3, 3) of the pose from the landmarks alone, in the base's frame
    point_pose         [x, y, heading] of the base in the distance field, from those points alone that are on no known
                       wall; it is `pose` in directions that they do not determine
    point_information  (3, 3) of `point_pose`, in the base's frame
    overlap_ratio      share of the scan's wall length that lies on known walls, 0 to 1
    fit                0 to 1, of all points at `pose`: points and landmarks must agree on a place; see `PointMatch`
    known              number of points in space that was seen before
    """

    pose: se2.Pose
    information: Floats
    point_pose: se2.Pose
    point_information: Floats
    overlap_ratio: float
    fit: float
    known: int

    @property
    def total_information(self) -> Floats:
        """Information (3, 3) of the pose from landmarks and points, without the prediction's, in the base's frame."""
        return self.information + self.point_information


def register(
    start: se2.Pose,
    prediction: se2.Pose,
    prior: Floats,
    scan: ScanFeatures,
    points: Floats,
    local_map: LocalMap,
    field: DistanceField,
    roughness: Roughness,
) -> Registration:
    """Estimate the pose of the base in the map for one scan.

    Minimises the squared Mahalanobis distances of matched landmarks and of points on no matched wall, both with Cauchy
    kernels, plus that of the pose from the prediction.

    start       [x, y, heading] of the base in the map where Gauss-Newton starts
    prediction  [x, y, heading] of the base in the map
    prior       (3, 3) information of the prediction in the base's frame; it fixes directions that nothing determines
    scan        segments and corners in the base's frame
    points      (p, 6) of the scan with normals, in the base's frame, see `surface_points`
    local_map   walls and corners in the map
    field       distance field in the map
    roughness   of the walls
    """
    segments, corners = scan.segments, scan.corners
    total = segments.total_length
    # Plain tuples: numba unpacks them faster than named ones.
    pose, information, point_information, point_pose, matched, fit, known = _register(
        start,
        prediction,
        prior,
        (segments.frame, segments.half_length, segments.covariance),
        (corners.position, corners.headings, corners.covariance),
        points,
        (local_map.frame, local_map.low, local_map.high, local_map.wall_covariance),
        (local_map.position, local_map.headings, local_map.corner_covariance),
        field.arrays,
        tuple(roughness),
    )  # fmt: skip
    overlap_ratio = matched / total if total else 0.0
    return Registration(pose, information, point_pose, point_information, overlap_ratio, fit, known)


@compiled
def _register(  # type: ignore[no-untyped-def]
    start, prediction, prior, segments, corners, points, walls, map_corners, field, roughness
):
    """Run Gauss-Newton; return the fields of `Registration`, the length on known walls instead of the ratio."""
    scan_segments, scan_corners = SegmentArrays(*segments), CornerArrays(*corners)
    frames, low, high, wall_covariance = walls
    map_walls = WallArrays(frames, axes_of(frames), low, high, wall_covariance)
    known_corners = CornerArrays(*map_corners)
    segment_of = lines_of(points, scan_segments.frame, scan_segments.half_length)
    information, point_information = np.zeros((3, 3)), np.zeros((3, 3))
    gradient, point_gradient, found = np.zeros(3), np.zeros(3), 0
    pose, point_pose, overlaps = start.copy(), start.copy(), np.zeros(len(scan_segments.frame))
    kept, memory, total = np.empty_like(points), memory_for(len(points)), np.empty((3, 3))
    for step in range(len(MATCH_OFFSET_GATES)):
        offset_gate, heading_gate = MATCH_OFFSET_GATES[step], MATCH_HEADING_GATES[step]
        information[:], gradient[:] = 0.0, 0.0
        add_walls(pose, scan_segments, map_walls, roughness, offset_gate, heading_gate, overlaps, information, gradient)
        add_corners(pose, scan_corners, known_corners, roughness, offset_gate, information, gradient)
        others = kept[: _keep_unmatched(points, segment_of, overlaps, kept)]
        found = add_points(pose, others, field, FINE_SIGMA, point_information, point_gradient, memory)
        pull = product(prior, difference(prediction, pose))
        for k in range(3):
            point_pose[k] = pose[k]
            gradient[k] = gradient[k] + point_gradient[k] + pull[k]
            for m in range(3):
                total[k, m] = information[k, m] + point_information[k, m] + prior[k, m]
        move_back(pose, solution(total, gradient))
    unbiased = unbiased_information(point_pose, kept, found, FINE_SIGMA, point_information, memory)
    # The step from where the points were linearised. Without the prior: odometry has a factor of its own in the graph.
    move_back(point_pose, solution(point_information + LINEAR_RANGE_INFORMATION, point_gradient))
    wrap_heading(pose)
    wrap_heading(point_pose)
    _, fit, known = points_cost(field, points, pose)
    return pose, information, unbiased, point_pose, overlaps.sum(), fit, known


@inlined
def _keep_unmatched(points, segment_of, overlaps, kept):  # type: ignore[no-untyped-def]
    """Copy the points (q, 6) that are on no segment, or on one that was not matched with a wall; return how many."""
    count = 0
    for k in range(len(points)):
        if segment_of[k] < 0 or overlaps[segment_of[k]] == 0.0:
            for c in range(COLUMNS):
                kept[count, c] = points[k, c]
            count += 1
    return count
