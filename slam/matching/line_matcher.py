"""Where the robot stands in the local map: what a scan shows, laid over the landmarks near the predicted pose.

Odometry in turns can be wrong by many degrees, which would pair walls wrongly; so Gauss-Newton with shrinking gates is
started from several headings around the prediction, and the pose that explains most wall wins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from drivers import se2

from ..geometry.angles import turn_of
from ..geometry.segments import CornerPoints, Floats, Segments
from ..mapping.local_map import LocalMap
from .likelihood_field import CELL as POINT_CELL
from .likelihood_field import LikelihoodField, ScanPoints

# Starts around the prediction [x, y, heading], nearest first: 15 degrees of odometry error in a turn are covered.
NEAR_STARTS = np.array([[0.0, 0.0, math.radians(angle)] for angle in (0, -8, 8, -16, 16)])
OFFSET_GATES = np.array([0.40, 0.40, 0.30, 0.20, 0.15, 0.10, 0.10, 0.10])  # metres across, one a Gauss-Newton step
HEADING_GATES = np.radians([10.0, 10.0, 9.0, 7.0, 6.0, 5.0, 5.0, 5.0])
CORNER_HEADING_GATE = math.radians(20.0)  # the walls that make a corner must run alike
OVERLAP_MARGIN = 0.5  # metres: a segment may lie this far beyond what is known of a wall and still count as seen there
CAUCHY_SCALE = 3.0  # standard deviations at which an observation counts half
CLEARLY_MORE = 0.03  # of the scan's wall length: how much more a start farther from the prediction must explain
POINT_SIGMA = 0.15  # metres: clutter looks different from elsewhere
POINT_GATE = 0.25  # metres


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """The outcome of laying a scan over the local map.

    pose               the base's pose in the map
    information        (3, 3) in the base's frame, of what the landmarks tell of the pose (without the prediction's own)
    point_information  (3, 3) likewise, of what the points on no wall tell
    explained          share of the scan's wall length that fell on known walls
    """

    pose: se2.Pose
    information: Floats
    point_information: Floats
    overlap_ratio: float

    @property
    def held_by(self) -> Floats:
        """(3, 3): information of the pose from everything that was seen, in the base's frame."""
        return self.information + self.point_information


@dataclass(frozen=True, slots=True, eq=False)
class ScanFeatures:
    """What a scan shows, in the base's frame."""

    segments: Segments
    corners: CornerPoints
    points: ScanPoints


def register(
    prediction: se2.Pose,
    prior: Floats,
    starts: Floats,
    scan: ScanFeatures,
    local_map: LocalMap,
    field: LikelihoodField,
    roughness: float,
) -> Registration:
    """The base's pose in the map for a scan.

    `prior` (3, 3) is the information of the predicted pose in the base's frame: it decides what walls leave open.
    `starts` (k, 3) are where Gauss-Newton starts, in the prediction's frame, the likeliest first.
    `flatness` is the variance of the walls' unevenness (metres squared).
    """
    segments, corners = scan.segments, scan.corners
    seen = float(2 * segments.half_length.sum())
    pose, information, point_information, length = _register(
        prediction, prior, starts, CLEARLY_MORE * seen,
        segments.frame, segments.half_length, segments.covariance,
        corners.position, corners.headings, corners.covariance,
        local_map.frame, local_map.low, local_map.high, local_map.wall_covariance,
        local_map.position, local_map.headings, local_map.corner_covariance, roughness,
        scan.points.loose, field.points, field.nearest, field.origin,
    )  # fmt: skip
    pose[2] = se2.wrap(pose[2])
    return Registration(pose, information, point_information, length / seen if seen else 0.0)


@njit(cache=True)
def _register(  # type: ignore[no-untyped-def]
    prediction, prior, starts, clearly_more,
    frames, halves, covariances, points, point_headings, point_covariances,
    walls, lows, highs, wall_covariances, corners, corner_headings, corner_covariances, roughness,
    loose, known, nearest, origin,
):  # fmt: skip
    """Gauss-Newton from every start; the pose that explains clearly most wall length, its information, that length."""
    best_pose, best_information, best_explained = prediction.copy(), np.zeros((3, 3)), -1.0
    best_point_information = np.zeros((3, 3))
    information, point_information, gradient = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    for start in starts:
        pose = prediction.copy()
        c, s = math.cos(prediction[2]), math.sin(prediction[2])
        pose[0] += c * start[0] - s * start[1]
        pose[1] += s * start[0] + c * start[1]
        pose[2] += start[2]
        overlap_ratio = 0.0
        for step in range(len(OFFSET_GATES)):
            information[:] = 0.0
            point_information[:] = 0.0
            gradient[:] = 0.0
            overlap_ratio = _add_walls(
                pose, frames, halves, covariances, walls, lows, highs, wall_covariances, roughness,
                OFFSET_GATES[step], HEADING_GATES[step], information, gradient,
            )  # fmt: skip
            _add_corners(
                pose, points, point_headings, point_covariances, corners, corner_headings, corner_covariances,
                roughness, OFFSET_GATES[step], information, gradient,
            )  # fmt: skip
            _add_points(pose, loose, known, nearest, origin, point_information, gradient)
            c, s = math.cos(pose[2]), math.sin(pose[2])
            ex, ey = pose[0] - prediction[0], pose[1] - prediction[1]
            error = np.array([c * ex + s * ey, -s * ex + c * ey, pose[2] - prediction[2]])
            move = np.linalg.solve(information + point_information + prior, gradient + prior @ error)
            pose[0] -= c * move[0] - s * move[1]
            pose[1] -= s * move[0] + c * move[1]
            pose[2] -= move[2]
        if overlap_ratio > best_explained + clearly_more:
            best_explained, best_pose, best_information = overlap_ratio, pose, information.copy()
            best_point_information = point_information.copy()
    return best_pose, best_information, best_point_information, best_explained


@njit(cache=True)
def _add_walls(  # type: ignore[no-untyped-def]
    pose, frames, halves, covariances, walls, lows, highs, wall_covariances, roughness,
    offset_gate, heading_gate, information, gradient,
):  # fmt: skip
    """Pair each segment with the nearest wall inside the gates and add its normal equations; the length explained."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    total = 0.0
    for i in range(len(frames)):
        x = pose[0] + c * frames[i, 0] - s * frames[i, 1]
        y = pose[1] + s * frames[i, 0] + c * frames[i, 1]
        best, match = np.inf, -1
        overlap = offset = turn = along = 0.0
        for j in range(len(walls)):
            angle = turn_of(pose[2] + frames[i, 2] - walls[j, 2])
            if abs(angle) > heading_gate:
                continue
            wc, ws = math.cos(walls[j, 2]), math.sin(walls[j, 2])
            dx, dy = x - walls[j, 0], y - walls[j, 1]
            across = -ws * dx + wc * dy
            if abs(across) > offset_gate:
                continue
            at = wc * dx + ws * dy
            shared = min(at + halves[i], highs[j] + OVERLAP_MARGIN) - max(at - halves[i], lows[j] - OVERLAP_MARGIN)
            distance = (across / offset_gate) ** 2 + (angle / heading_gate) ** 2
            if shared > 0.0 and distance < best:
                best, match, overlap, offset, turn, along = distance, j, min(shared, 2 * halves[i]), across, angle, at
        if match < 0:
            continue
        wall = wall_covariances[match]
        syy = covariances[i, 0, 0] + roughness + wall[0, 0] + 2 * along * wall[0, 1] + along * along * wall[1, 1]
        syt = covariances[i, 0, 1] + wall[0, 1] + along * wall[1, 1]
        stt = covariances[i, 1, 1] + 3 * roughness / halves[i] ** 2 + wall[1, 1]
        determinant = syy * stt - syt * syt
        wyy, wtt, wyt = stt / determinant, syy / determinant, -syt / determinant
        chi2 = wyy * offset * offset + 2 * wyt * offset * turn + wtt * turn * turn
        weight = 1.0 / (1.0 + chi2 / (CAUCHY_SCALE * CAUCHY_SCALE))
        total += overlap * (1.0 - 0.25 * best)
        # how the offset changes as the base moves forward, left, and turns
        wc, ws = math.cos(walls[match, 2]), math.sin(walls[match, 2])
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


@njit(cache=True)
def _add_corners(  # type: ignore[no-untyped-def]
    pose, points, headings, covariances, corners, corner_headings, corner_covariances, roughness,
    gate, information, gradient,
):  # fmt: skip
    """Pair each corner with the nearest known one inside the gate and add its normal equations."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    rotation = np.array([[c, -s], [s, c]])
    for i in range(len(points)):
        lever = rotation @ points[i]
        best, match = gate * gate, -1
        for j in range(len(corners)):
            dx, dy = pose[0] + lever[0] - corners[j, 0], pose[1] + lever[1] - corners[j, 1]
            distance = dx * dx + dy * dy
            if (
                distance < best
                and abs(turn_of(pose[2] + headings[i, 0] - corner_headings[j, 0])) < CORNER_HEADING_GATE
                and abs(turn_of(pose[2] + headings[i, 1] - corner_headings[j, 1])) < CORNER_HEADING_GATE
            ):
                best, match = distance, j
        if match < 0:
            continue
        covariance = rotation @ covariances[i] @ rotation.T + corner_covariances[match]
        covariance[0, 0] += roughness
        covariance[1, 1] += roughness
        weights = np.linalg.inv(covariance)
        residual = np.array([pose[0] + lever[0] - corners[match, 0], pose[1] + lever[1] - corners[match, 1]])
        chi2 = residual @ weights @ residual
        jacobian = np.array([[c, -s, -lever[1]], [s, c, lever[0]]])
        # a corner is made of the ends of two segments that count already: it adds what they cannot say, at half weight
        weight = 0.5 / (1.0 + chi2 / (CAUCHY_SCALE * CAUCHY_SCALE))
        information += weight * (jacobian.T @ weights @ jacobian)
        gradient += weight * (jacobian.T @ (weights @ residual))


@njit(cache=True)
def _add_points(pose, points, known, nearest, origin, information, gradient):  # type: ignore[no-untyped-def]
    """Pull each point that lies on no line to the nearest one of those that the last keyframes saw."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for p in range(len(points)):
        lever_x, lever_y = c * points[p, 0] - s * points[p, 1], s * points[p, 0] + c * points[p, 1]
        x, y = pose[0] + lever_x, pose[1] + lever_y
        i, j = math.floor((x - origin[0]) / POINT_CELL), math.floor((y - origin[1]) / POINT_CELL)
        if i < 0 or j < 0 or i >= nearest.shape[0] or j >= nearest.shape[1] or nearest[i, j] < 0:
            continue
        dx, dy = x - known[nearest[i, j], 0], y - known[nearest[i, j], 1]
        squared = dx * dx + dy * dy
        if squared > POINT_GATE * POINT_GATE:
            continue
        weight = 1.0 / (POINT_SIGMA * POINT_SIGMA * (1.0 + squared / (POINT_SIGMA * POINT_SIGMA)))
        # the base's own axes: forward (c, s), left (-s, c), and turning, which moves the point across its lever
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
