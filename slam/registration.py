"""Where the robot stands in the local map: a scan's segments and corners laid over the landmarks near the predicted pose.

Odometry in turns can be wrong by many degrees, which would pair walls wrongly; so Gauss-Newton with shrinking gates is
started from several headings around the prediction, and the pose that explains most wall wins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from drivers import se2

from .local_map import LocalMap
from .segments import CornerPoints, Floats, Segments

# Starts around the prediction [x, y, heading], nearest first: 15 degrees of odometry error in a turn are covered.
NEAR_STARTS = np.array([[0.0, 0.0, math.radians(angle)] for angle in (0, -8, 8, -16, 16)])
# Where the near starts explain little of the scan: wheels that slipped, or odometry that stood still for a second.
FAR_STARTS = np.array(
    [
        [x, y, math.radians(angle)]
        for x, y in ((0, 0), (0.5, 0), (-0.5, 0), (0, 0.5), (0, -0.5), (1, 0), (-1, 0), (0, 1), (0, -1))
        for angle in range(-60, 61, 10)
    ]
)
OFFSET_GATES = np.array([0.40, 0.40, 0.30, 0.20, 0.15, 0.10, 0.10, 0.10])  # metres across, one a Gauss-Newton step
HEADING_GATES = np.radians([10.0, 10.0, 9.0, 7.0, 6.0, 5.0, 5.0, 5.0])
CORNER_HEADING_GATE = math.radians(20.0)  # the walls that make a corner must run alike
OVERLAP_MARGIN = 0.5  # metres: a segment may lie this far beyond what is known of a wall and still count as seen there
CAUCHY_SCALE = 3.0  # standard deviations at which an observation counts half
CLEARLY_MORE = 0.03  # of the scan's wall length: how much more a start farther from the prediction must explain
EXPLAINED_ENOUGH = 0.5  # share of the scan's wall length below which the far starts are tried
FAR_EXPLAINED = 0.75  # what a far start must explain to be believed
FAR_LENGTH = 3.0  # metres of wall that a scan must show for that


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """The outcome of laying a scan over the local map.

    pose         the base's pose in the map
    information  (3, 3) in the base's frame, of what the landmarks tell of the pose (without the prediction's own)
    explained    share of the scan's wall length that fell on known walls
    recovered    whether it took a start far from the prediction
    """

    pose: se2.Pose
    information: Floats
    explained: float
    recovered: bool


def register(
    prediction: se2.Pose, prior: Floats, segments: Segments, corners: CornerPoints, local_map: LocalMap, flatness: float
) -> Registration:
    """The base's pose in the map for a scan.

    `prior` (3, 3) is the information of the predicted pose in the base's frame: it decides what walls leave open.
    `flatness` is the variance of the walls' unevenness (metres squared).
    """
    seen = float(2 * segments.half_length.sum())
    if not len(segments) or not len(local_map.walls):
        return Registration(prediction.copy(), np.zeros((3, 3)), 0.0, False)
    scan = (segments.frame, segments.half_length, segments.covariance)
    points = (corners.position, corners.headings, corners.covariance)
    walls = (local_map.frame, local_map.low, local_map.high, local_map.wall_covariance)
    known = (local_map.position, local_map.headings, local_map.corner_covariance)

    def best_of(starts: Floats) -> tuple[se2.Pose, Floats, float]:
        pose, information, length = _register(
            prediction, prior, starts, CLEARLY_MORE * seen, *scan, *points, *walls, *known, flatness
        )
        return pose, information, length / seen

    recovered = False
    pose, information, explained = best_of(NEAR_STARTS)
    if explained < EXPLAINED_ENOUGH and seen > FAR_LENGTH:
        far_pose, far_information, far_explained = best_of(FAR_STARTS)
        if far_explained > FAR_EXPLAINED:
            pose, information, explained, recovered = far_pose, far_information, far_explained, True
    pose[2] = se2.wrap(pose[2])
    return Registration(pose, information, explained, recovered)


@njit(cache=True)
def _turn(angle):  # type: ignore[no-untyped-def]
    return angle - 2 * math.pi * math.floor((angle + math.pi) / (2 * math.pi))


@njit(cache=True)
def _register(  # type: ignore[no-untyped-def]
    prediction, prior, starts, clearly_more,
    frames, halves, covariances, points, point_headings, point_covariances,
    walls, lows, highs, wall_covariances, corners, corner_headings, corner_covariances, flatness,
):  # fmt: skip
    """Gauss-Newton from every start; the pose that explains clearly most wall length, its information and that length."""
    best_pose, best_information, best_explained = prediction.copy(), np.zeros((3, 3)), -1.0
    information, gradient = np.zeros((3, 3)), np.zeros(3)
    for start in starts:
        pose = prediction.copy()
        c, s = math.cos(prediction[2]), math.sin(prediction[2])
        pose[0] += c * start[0] - s * start[1]
        pose[1] += s * start[0] + c * start[1]
        pose[2] += start[2]
        explained = 0.0
        for step in range(len(OFFSET_GATES)):
            information[:] = 0.0
            gradient[:] = 0.0
            explained = _add_walls(
                pose, frames, halves, covariances, walls, lows, highs, wall_covariances, flatness,
                OFFSET_GATES[step], HEADING_GATES[step], information, gradient,
            )  # fmt: skip
            _add_corners(
                pose, points, point_headings, point_covariances, corners, corner_headings, corner_covariances, flatness,
                OFFSET_GATES[step], information, gradient,
            )  # fmt: skip
            c, s = math.cos(pose[2]), math.sin(pose[2])
            ex, ey = pose[0] - prediction[0], pose[1] - prediction[1]
            error = np.array([c * ex + s * ey, -s * ex + c * ey, pose[2] - prediction[2]])
            move = np.linalg.solve(information + prior, gradient + prior @ error)
            pose[0] -= c * move[0] - s * move[1]
            pose[1] -= s * move[0] + c * move[1]
            pose[2] -= move[2]
        if explained > best_explained + clearly_more:
            best_explained, best_pose, best_information = explained, pose, information.copy()
    return best_pose, best_information, best_explained


@njit(cache=True)
def _add_walls(  # type: ignore[no-untyped-def]
    pose, frames, halves, covariances, walls, lows, highs, wall_covariances, flatness,
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
            angle = _turn(pose[2] + frames[i, 2] - walls[j, 2])
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
        syy = covariances[i, 0, 0] + flatness + wall[0, 0] + 2 * along * wall[0, 1] + along * along * wall[1, 1]
        syt = covariances[i, 0, 1] + wall[0, 1] + along * wall[1, 1]
        stt = covariances[i, 1, 1] + 3 * flatness / halves[i] ** 2 + wall[1, 1]
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
    pose, points, headings, covariances, corners, corner_headings, corner_covariances, flatness,
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
                and abs(_turn(pose[2] + headings[i, 0] - corner_headings[j, 0])) < CORNER_HEADING_GATE
                and abs(_turn(pose[2] + headings[i, 1] - corner_headings[j, 1])) < CORNER_HEADING_GATE
            ):
                best, match = distance, j
        if match < 0:
            continue
        covariance = rotation @ covariances[i] @ rotation.T + corner_covariances[match]
        covariance[0, 0] += flatness
        covariance[1, 1] += flatness
        weights = np.linalg.inv(covariance)
        residual = np.array([pose[0] + lever[0] - corners[match, 0], pose[1] + lever[1] - corners[match, 1]])
        chi2 = residual @ weights @ residual
        jacobian = np.array([[c, -s, -lever[1]], [s, c, lever[0]]])
        # a corner is made of the ends of two segments that count already: it adds what they cannot say, at half weight
        weight = 0.5 / (1.0 + chi2 / (CAUCHY_SCALE * CAUCHY_SCALE))
        information += weight * (jacobian.T @ weights @ jacobian)
        gradient += weight * (jacobian.T @ (weights @ residual))
