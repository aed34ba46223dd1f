"""Register a scan: estimate the base's pose in the local map from the scan's segments, corners and other points.

Gauss-Newton with shrinking gates: each step pairs features within the gates anew and solves the normal equations. It
starts where all points of the scan fit best (see `point_matcher`), so that walls are not paired wrongly in turns. Each
point is used once: those on segments that are paired with walls count by these, all others by the distance field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drivers import se2
from drivers.compiled import compiled

from ..geometry.angles import axes_of, wrap_angle
from ..geometry.segments import CornerPoints, Floats, Segments
from ..geometry.small_matrices import solve
from ..mapping.local_map import LocalMap
from .distance_field import DistanceField
from .interpolation import add_points
from .point_matcher import FINE_SIGMA, move_back, pose_error
from .scan_points import ScanPoints, segments_of

# Metres across a wall between it and a segment, for each Gauss-Newton step; also between two
# corners. Origin: tuned on Intel, fr079, CSAIL.
MATCH_OFFSET_GATES = np.array([0.40, 0.40, 0.30, 0.20, 0.15, 0.10, 0.10, 0.10])
# Radians between a wall and a segment, for each Gauss-Newton step. Origin: tuned on Intel, fr079, CSAIL.
MATCH_HEADING_GATES = np.radians([10.0, 10.0, 9.0, 7.0, 6.0, 5.0, 5.0, 5.0])
# Radians between the walls of an observed corner and those of a map corner.
# Origin: chosen, twice the widest heading gate of segments; not measured.
CORNER_HEADING_GATE = math.radians(20.0)
# Metres beyond the known end of a wall in which a segment still overlaps with it.
# Origin: chosen, walls continue beyond what was seen of them; not measured.
MATCH_END_MARGIN = 0.5
# Scale of the Cauchy kernel, standard deviations: an observation this far off has half weight.
# Origin: chosen, the usual range of robust kernels; not measured.
MATCH_CAUCHY_SCALE = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Result of registering a scan with the local map.

    pose               [x, y, heading] of the base in the map, from landmarks, points and the prediction
    information        (3, 3) of the pose from the landmarks alone, in the base's frame
    point_pose         [x, y, heading] of the base in the distance field, from those points alone that are on no known
                       wall; it is `pose` in directions that they do not determine
    point_information  (3, 3) of `point_pose`, in the base's frame
    overlap_ratio      share of the scan's wall length that lies on known walls, 0 to 1
    """

    pose: se2.Pose
    information: Floats
    point_pose: se2.Pose
    point_information: Floats
    overlap_ratio: float

    @property
    def total_information(self) -> Floats:
        """Information (3, 3) of the pose from landmarks and points, without the prediction's, in the base's frame."""
        return self.information + self.point_information


@dataclass(frozen=True, slots=True, eq=False)
class ScanFeatures:
    """Features of one scan, in the base's frame."""

    segments: Segments
    corners: CornerPoints
    points: ScanPoints


class _SegmentArrays(NamedTuple):
    """Arrays of `Segments`."""

    frame: Floats
    half_length: Floats
    covariance: Floats


class _CornerArrays(NamedTuple):
    """Arrays of the corners of a scan or of the map: position (n, 2), headings (n, 2), covariance (n, 2, 2)."""

    position: Floats
    headings: Floats
    covariance: Floats


class _WallArrays(NamedTuple):
    """Arrays of the walls of a `LocalMap`; axis (n, 2) is the unit vector along each."""

    frame: Floats
    axis: Floats
    low: Floats
    high: Floats
    covariance: Floats


def register(
    start: se2.Pose,
    prediction: se2.Pose,
    prior: Floats,
    scan: ScanFeatures,
    points: Floats,
    local_map: LocalMap,
    field: DistanceField,
    roughness: float,
) -> Registration:
    """Estimate the pose of the base in the map for one scan.

    Minimises the squared Mahalanobis distances of matched landmarks and of points on no matched wall, both with Cauchy
    kernels, plus that of the pose from the prediction.

    start       [x, y, heading] of the base in the map where Gauss-Newton starts
    prediction  [x, y, heading] of the base in the map
    prior       (3, 3) information of the prediction in the base's frame; it fixes directions that nothing determines
    scan        segments and corners in the base's frame
    points      (p, 4) of the scan with normals, in the base's frame, see `surface_points`
    local_map   walls and corners in the map
    field       distance field in the map
    roughness   variance of the wall roughness (metres squared)
    """
    segments, corners = scan.segments, scan.corners
    total = segments.total_length
    # Plain tuples: numba unpacks them faster than named ones.
    pose, information, point_information, point_pose, matched = _register(
        start,
        prediction,
        prior,
        (segments.frame, segments.half_length, segments.covariance),
        (corners.position, corners.headings, corners.covariance),
        (points, segments_of(points, segments)),
        (local_map.frame, axes_of(local_map.frame), local_map.low, local_map.high, local_map.wall_covariance),
        (local_map.position, local_map.headings, local_map.corner_covariance),
        field.arrays,
        roughness,
    )  # fmt: skip
    pose[2] = se2.wrap(pose[2])
    point_pose[2] = se2.wrap(point_pose[2])
    return Registration(pose, information, point_pose, point_information, matched / total if total else 0.0)


@compiled
def _register(  # type: ignore[no-untyped-def]
    start, prediction, prior, segments, corners, points, walls, map_corners, field, roughness
):
    """Run Gauss-Newton; return the fields of `Registration`, the length on known walls instead of the ratio."""
    scan_segments, scan_corners = _SegmentArrays(*segments), _CornerArrays(*corners)
    map_walls, known_corners = _WallArrays(*walls), _CornerArrays(*map_corners)
    all_points, segment_of = points
    information, point_information = np.zeros((3, 3)), np.zeros((3, 3))
    gradient, point_gradient = np.zeros(3), np.zeros(3)
    pose, point_pose, overlaps = start.copy(), start.copy(), np.zeros(len(scan_segments.frame))
    for step in range(len(MATCH_OFFSET_GATES)):
        offset_gate, heading_gate = MATCH_OFFSET_GATES[step], MATCH_HEADING_GATES[step]
        information[:], gradient[:] = 0.0, 0.0
        _add_walls(
            pose, scan_segments, map_walls, roughness, offset_gate, heading_gate, overlaps, information, gradient
        )
        _add_corners(pose, scan_corners, known_corners, roughness, offset_gate, information, gradient)
        others = _without_matched(all_points, segment_of, overlaps)
        add_points(pose, others, field, FINE_SIGMA, point_information, point_gradient)
        total = information + point_information + prior
        point_pose[:] = pose
        move_back(pose, solve(total, gradient + point_gradient + prior @ pose_error(prediction, pose)))
    move_back(point_pose, solve(point_information + prior, point_gradient))  # from where it is linearised
    return pose, information, point_information, point_pose, overlaps.sum()


@compiled
def _without_matched(points, segment_of, overlaps):  # type: ignore[no-untyped-def]
    """Return the points (q, 4) that are on no segment, or on one that was not matched with a wall."""
    kept, count = np.empty_like(points), 0
    for k in range(len(points)):
        if segment_of[k] < 0 or overlaps[segment_of[k]] == 0.0:
            kept[count] = points[k]
            count += 1
    return kept[:count]


@compiled
def _add_walls(  # type: ignore[no-untyped-def]
    pose, segments, walls, roughness, offset_gate, heading_gate, overlaps, information, gradient
):
    """Pair each segment with the nearest wall inside the gates and add its normal equations.

    Sets `overlaps`, the length in metres of each segment that lies on its wall, zero if there is none; weighted down by
    up to half of it near the gates' limits.
    """
    frames = segments.frame
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for i in range(len(frames)):
        lever_x, lever_y = c * frames[i, 0] - s * frames[i, 1], s * frames[i, 0] + c * frames[i, 1]
        match, best, overlap, offset, turn, along = _match_segment(
            pose[0] + lever_x, pose[1] + lever_y, pose[2] + frames[i, 2], segments.half_length[i],
            walls, offset_gate, heading_gate,
        )  # fmt: skip
        overlaps[i] = overlap * (1.0 - 0.25 * best)
        if match < 0:
            continue
        wyy, wyt, wtt = _wall_weights(
            segments.covariance[i], segments.half_length[i], walls.covariance[match], along, roughness
        )
        chi2 = wyy * offset * offset + 2 * wyt * offset * turn + wtt * turn * turn
        weight = 1.0 / (1.0 + chi2 / (MATCH_CAUCHY_SCALE * MATCH_CAUCHY_SCALE))
        wyy, wyt, wtt = weight * wyy, weight * wyt, weight * wtt
        # derivatives of the offset with respect to moving forward, left, and turning
        wc, ws = walls.axis[match, 0], walls.axis[match, 1]
        j0, j1, j2 = wc * s - ws * c, wc * c + ws * s, wc * lever_x + ws * lever_y
        residual = wyy * offset + wyt * turn
        gradient[0] += j0 * residual
        gradient[1] += j1 * residual
        gradient[2] += j2 * residual + wyt * offset + wtt * turn
        information[0, 0] += wyy * j0 * j0
        information[1, 1] += wyy * j1 * j1
        information[2, 2] += wyy * j2 * j2 + 2 * wyt * j2 + wtt
        information[0, 1] += wyy * j0 * j1
        information[0, 2] += j0 * (wyy * j2 + wyt)
        information[1, 2] += j1 * (wyy * j2 + wyt)
    information[1, 0], information[2, 0], information[2, 1] = information[0, 1], information[0, 2], information[1, 2]


@compiled
def _wall_weights(segment, half, wall, along, roughness):  # type: ignore[no-untyped-def]
    """Return the information of the offset and heading of a segment relative to its wall: (yy, yt, tt).

    `segment` and `wall` are the covariances (2, 2) of both, `along` the position of the segment's middle on the wall.
    """
    yy = segment[0, 0] + roughness + wall[0, 0] + 2 * along * wall[0, 1] + along * along * wall[1, 1]
    yt = segment[0, 1] + wall[0, 1] + along * wall[1, 1]
    tt = segment[1, 1] + 3 * roughness / half**2 + wall[1, 1]
    determinant = yy * tt - yt * yt
    return tt / determinant, -yt / determinant, yy / determinant


@compiled
def _match_segment(x, y, heading, half, walls, offset_gate, heading_gate):  # type: ignore[no-untyped-def]
    """Match a segment at (x, y, heading) in the map with the nearest wall inside the gates.

    Returns the wall's row (-1 for none), the squared distance relative to the gates, the overlap in metres, the offset,
    the heading difference, and the position along the wall.
    """
    best, match = 2.0, -1  # the largest distance inside the gates
    overlap = offset = turn = along = 0.0
    for j in range(len(walls.frame)):
        angle = wrap_angle(heading - walls.frame[j, 2])
        if abs(angle) > heading_gate:
            continue
        wc, ws = walls.axis[j, 0], walls.axis[j, 1]
        dx, dy = x - walls.frame[j, 0], y - walls.frame[j, 1]
        across = wc * dy - ws * dx
        if abs(across) > offset_gate:
            continue
        at = wc * dx + ws * dy
        shared = min(at + half, walls.high[j] + MATCH_END_MARGIN) - max(at - half, walls.low[j] - MATCH_END_MARGIN)
        distance = (across / offset_gate) ** 2 + (angle / heading_gate) ** 2
        if shared > 0.0 and distance < best:
            best, match, overlap, offset, turn, along = distance, j, min(shared, 2 * half), across, angle, at
    return match, best, overlap, offset, turn, along


@compiled
def _add_corners(  # type: ignore[no-untyped-def]
    pose, observed, corners, roughness, gate, information, gradient
):
    """Pair each corner with the nearest map corner inside the gate and add its normal equations."""
    points, headings = observed.position, observed.headings
    c, s = math.cos(pose[2]), math.sin(pose[2])
    rotation = np.array([[c, -s], [s, c]])
    for i in range(len(points)):
        lever = rotation @ points[i]
        best, match = gate * gate, -1
        for j in range(len(corners.position)):
            dx, dy = pose[0] + lever[0] - corners.position[j, 0], pose[1] + lever[1] - corners.position[j, 1]
            distance = dx * dx + dy * dy
            if (
                distance < best
                and abs(wrap_angle(pose[2] + headings[i, 0] - corners.headings[j, 0])) < CORNER_HEADING_GATE
                and abs(wrap_angle(pose[2] + headings[i, 1] - corners.headings[j, 1])) < CORNER_HEADING_GATE
            ):
                best, match = distance, j
        if match < 0:
            continue
        covariance = rotation @ observed.covariance[i] @ rotation.T + corners.covariance[match]
        covariance[0, 0] += roughness
        covariance[1, 1] += roughness
        weights = np.linalg.inv(covariance)
        residual = np.array(
            [pose[0] + lever[0] - corners.position[match, 0], pose[1] + lever[1] - corners.position[match, 1]]
        )
        chi2 = residual @ weights @ residual
        jacobian = np.array([[c, -s, -lever[1]], [s, c, lever[0]]])
        # Half weight: a corner is computed from the ends of two segments that are already matched to walls.
        weight = 0.5 / (1.0 + chi2 / (MATCH_CAUCHY_SCALE * MATCH_CAUCHY_SCALE))
        information += weight * (jacobian.T @ weights @ jacobian)
        gradient += weight * (jacobian.T @ (weights @ residual))
