"""Register a scan: estimate the base's pose in the local map from the scan's segments, corners and clutter points.

Gauss-Newton with shrinking gates: each step pairs features within the gates anew and solves the normal equations. In
turns odometry can be wrong by many degrees, and walls would be paired wrongly. Gauss-Newton is therefore started from
several headings around the prediction, and the pose with the largest matched wall length is taken.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.compiled import compiled

from ..geometry.angles import wrap_angle
from ..geometry.segments import CornerPoints, Floats, Segments
from ..mapping.local_map import LocalMap
from .likelihood_field import FIELD_CELL, LikelihoodField, ScanPoints

# Starts [x, y, heading] in the prediction's frame, nearest first: they cover 15 degrees of odometry error in a turn.
# Origin: tuned on Intel, fr079, CSAIL.
NEAR_STARTS = np.array([[0.0, 0.0, math.radians(angle)] for angle in (0, -8, 8, -16, 16)])
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
# Share of the scan's wall length by which a start farther from the prediction must match more than a nearer one.
# Origin: chosen, keeps the start at the prediction if the matches are equal; not measured.
MIN_START_GAIN = 0.03
# Metres, standard deviation of a clutter point: clutter looks different from each viewpoint.
# Origin: chosen; not measured.
POINT_SIGMA = 0.15
# Metres between a clutter point and the nearest one of the likelihood field.
# Origin: chosen, the largest distance that the likelihood field stores; not measured.
POINT_GATE = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Result of registering a scan with the local map.

    pose               [x, y, heading] of the base in the map
    information        (3, 3) of the pose from the landmarks, in the base's frame, without the prior's
    point_information  (3, 3) of the pose from the clutter points, in the base's frame
    overlap_ratio      share of the scan's wall length that lies on known walls, 0 to 1
    """

    pose: se2.Pose
    information: Floats
    point_information: Floats
    overlap_ratio: float

    @property
    def total_information(self) -> Floats:
        """Information (3, 3) of the pose from all features, in the base's frame."""
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
    """Arrays of the walls of a `LocalMap`."""

    frame: Floats
    low: Floats
    high: Floats
    covariance: Floats


class _PointArrays(NamedTuple):
    """Arrays of a `LikelihoodField`."""

    points: Floats
    nearest: NDArray[np.int32]
    origin: Floats


def register(
    prediction: se2.Pose,
    prior: Floats,
    starts: Floats,
    scan: ScanFeatures,
    local_map: LocalMap,
    field: LikelihoodField,
    roughness: float,
) -> Registration:
    """Estimate the pose of the base in the map for one scan.

    Minimises the squared Mahalanobis distances of matched features plus that of the pose from the prediction.

    prediction  [x, y, heading] of the base in the map
    prior       (3, 3) information of the prediction in the base's frame; it fixes directions that no feature determines
    starts      (k, 3) starting poses of Gauss-Newton in the prediction's frame, the most likely first
    roughness   variance of the wall roughness (metres squared)
    """
    segments, corners = scan.segments, scan.corners
    total = float(2 * segments.half_length.sum())
    # Plain tuples: numba unpacks them faster than named ones.
    pose, information, point_information, matched = _register(
        prediction,
        prior,
        starts,
        MIN_START_GAIN * total,
        (segments.frame, segments.half_length, segments.covariance),
        (corners.position, corners.headings, corners.covariance),
        scan.points.clutter,
        (local_map.frame, local_map.low, local_map.high, local_map.wall_covariance),
        (local_map.position, local_map.headings, local_map.corner_covariance),
        (field.points, field.nearest, field.origin),
        roughness,
    )
    pose[2] = se2.wrap(pose[2])
    return Registration(pose, information, point_information, matched / total if total else 0.0)


@compiled
def _register(  # type: ignore[no-untyped-def]
    prediction, prior, starts, min_gain, segments, corners, clutter, walls, map_corners, field, roughness
):
    """Run Gauss-Newton from every start.

    Returns the pose that matches most wall length, by at least `min_gain` metres more than earlier starts; its
    information from landmarks and from clutter points; and that length.
    """
    scan_segments, scan_corners = _SegmentArrays(*segments), _CornerArrays(*corners)
    map_walls, known_corners, point_field = _WallArrays(*walls), _CornerArrays(*map_corners), _PointArrays(*field)
    best_pose, best_information, best_matched = prediction.copy(), np.zeros((3, 3)), -1.0
    best_point_information = np.zeros((3, 3))
    information, point_information, gradient = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    for start in starts:
        pose = prediction.copy()
        c, s = math.cos(prediction[2]), math.sin(prediction[2])
        pose[0] += c * start[0] - s * start[1]
        pose[1] += s * start[0] + c * start[1]
        pose[2] += start[2]
        matched = 0.0
        for step in range(len(MATCH_OFFSET_GATES)):
            offset_gate, heading_gate = MATCH_OFFSET_GATES[step], MATCH_HEADING_GATES[step]
            information[:] = 0.0
            point_information[:] = 0.0
            gradient[:] = 0.0
            matched = _add_walls(
                pose, scan_segments, map_walls, roughness, offset_gate, heading_gate, information, gradient
            )
            _add_corners(pose, scan_corners, known_corners, roughness, offset_gate, information, gradient)
            _add_points(pose, clutter, point_field, point_information, gradient)
            c, s = math.cos(pose[2]), math.sin(pose[2])
            ex, ey = pose[0] - prediction[0], pose[1] - prediction[1]
            error = np.array([c * ex + s * ey, -s * ex + c * ey, pose[2] - prediction[2]])
            move = np.linalg.solve(information + point_information + prior, gradient + prior @ error)
            pose[0] -= c * move[0] - s * move[1]
            pose[1] -= s * move[0] + c * move[1]
            pose[2] -= move[2]
        if matched > best_matched + min_gain:
            best_matched, best_pose, best_information = matched, pose, information.copy()
            best_point_information = point_information.copy()
    return best_pose, best_information, best_point_information, best_matched


@compiled
def _add_walls(  # type: ignore[no-untyped-def]
    pose, segments, walls, roughness, offset_gate, heading_gate, information, gradient
):
    """Pair each segment with the nearest wall inside the gates and add its normal equations.

    Returns the matched wall length in metres, weighted down by up to a quarter of it near the gates' limits.
    """
    frames, halves, covariances = segments.frame, segments.half_length, segments.covariance
    c, s = math.cos(pose[2]), math.sin(pose[2])
    total = 0.0
    for i in range(len(frames)):
        x = pose[0] + c * frames[i, 0] - s * frames[i, 1]
        y = pose[1] + s * frames[i, 0] + c * frames[i, 1]
        match, best, overlap, offset, turn, along = _match_segment(
            x, y, pose[2] + frames[i, 2], halves[i], walls, offset_gate, heading_gate
        )
        if match < 0:
            continue
        wall = walls.covariance[match]
        syy = covariances[i, 0, 0] + roughness + wall[0, 0] + 2 * along * wall[0, 1] + along * along * wall[1, 1]
        syt = covariances[i, 0, 1] + wall[0, 1] + along * wall[1, 1]
        stt = covariances[i, 1, 1] + 3 * roughness / halves[i] ** 2 + wall[1, 1]
        determinant = syy * stt - syt * syt
        wyy, wtt, wyt = stt / determinant, syy / determinant, -syt / determinant
        chi2 = wyy * offset * offset + 2 * wyt * offset * turn + wtt * turn * turn
        weight = 1.0 / (1.0 + chi2 / (MATCH_CAUCHY_SCALE * MATCH_CAUCHY_SCALE))
        total += overlap * (1.0 - 0.25 * best)
        # derivatives of the offset with respect to moving forward, left, and turning
        wc, ws = math.cos(walls.frame[match, 2]), math.sin(walls.frame[match, 2])
        j0, j1 = -ws * c + wc * s, ws * s + wc * c
        j2 = ws * (y - pose[1]) + wc * (x - pose[0])
        ry, rt = weight * (wyy * offset + wyt * turn), weight * (wyt * offset + wtt * turn)
        gradient[0] += j0 * ry
        gradient[1] += j1 * ry
        gradient[2] += j2 * ry + rt
        information[0, 0] += weight * wyy * j0 * j0
        information[1, 1] += weight * wyy * j1 * j1
        information[2, 2] += weight * (wyy * j2 * j2 + 2 * wyt * j2 + wtt)
        i01, i02, i12 = weight * wyy * j0 * j1, weight * j0 * (wyy * j2 + wyt), weight * j1 * (wyy * j2 + wyt)
        information[0, 1] += i01
        information[1, 0] += i01
        information[0, 2] += i02
        information[2, 0] += i02
        information[1, 2] += i12
        information[2, 1] += i12
    return total


@compiled
def _match_segment(x, y, heading, half, walls, offset_gate, heading_gate):  # type: ignore[no-untyped-def]
    """Match a segment at (x, y, heading) in the map with the nearest wall inside the gates.

    Returns the wall's row (-1 for none), the squared distance relative to the gates, the overlap in metres, the offset,
    the heading difference, and the position along the wall.
    """
    best, match = np.inf, -1
    overlap = offset = turn = along = 0.0
    for j in range(len(walls.frame)):
        angle = wrap_angle(heading - walls.frame[j, 2])
        if abs(angle) > heading_gate:
            continue
        wc, ws = math.cos(walls.frame[j, 2]), math.sin(walls.frame[j, 2])
        dx, dy = x - walls.frame[j, 0], y - walls.frame[j, 1]
        across = -ws * dx + wc * dy
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


@compiled
def _add_points(pose, points, field, information, gradient):  # type: ignore[no-untyped-def]
    """Pair each clutter point with the nearest one of the likelihood field and add its normal equations."""
    known, nearest, origin = field.points, field.nearest, field.origin
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for p in range(len(points)):
        lever_x, lever_y = c * points[p, 0] - s * points[p, 1], s * points[p, 0] + c * points[p, 1]
        x, y = pose[0] + lever_x, pose[1] + lever_y
        i, j = math.floor((x - origin[0]) / FIELD_CELL), math.floor((y - origin[1]) / FIELD_CELL)
        if i < 0 or j < 0 or i >= nearest.shape[0] or j >= nearest.shape[1] or nearest[i, j] < 0:
            continue
        dx, dy = x - known[nearest[i, j], 0], y - known[nearest[i, j], 1]
        squared = dx * dx + dy * dy
        if squared > POINT_GATE * POINT_GATE:
            continue
        weight = 1.0 / (POINT_SIGMA * POINT_SIGMA * (1.0 + squared / (POINT_SIGMA * POINT_SIGMA)))
        # axes of the base: forward (c, s), left (-s, c), and turning, which moves the point across its lever
        forward, left, across = c * dx + s * dy, -s * dx + c * dy, -lever_y * dx + lever_x * dy
        turn_forward, turn_left = -points[p, 1], points[p, 0]
        gradient[0] += weight * forward
        gradient[1] += weight * left
        gradient[2] += weight * across
        information[0, 0] += weight
        information[1, 1] += weight
        information[0, 2] += weight * turn_forward
        information[2, 0] += weight * turn_forward
        information[1, 2] += weight * turn_left
        information[2, 1] += weight * turn_left
        information[2, 2] += weight * (turn_forward * turn_forward + turn_left * turn_left)
