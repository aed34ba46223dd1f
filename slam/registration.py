"""Where the robot stands in the local map: the segments of a scan laid over the landmarks near the predicted pose.

Odometry in turns can be wrong by many degrees, which would pair walls wrongly; so Gauss-Newton with shrinking gates is
started from several headings around the prediction, and the pose that explains most wall wins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers import se2

from .segments import Floats, Segments

HEADING_STARTS = np.radians(
    [0.0, -8.0, 8.0, -16.0, 16.0]
)  # covers 15 degrees of odometry error; the prediction first, so it wins ties
OFFSET_GATES = np.array(
    [0.40, 0.40, 0.30, 0.20, 0.15, 0.10, 0.10, 0.10]
)  # metres across the wall, one a Gauss-Newton step
HEADING_GATES = np.radians([10.0, 10.0, 9.0, 7.0, 6.0, 5.0, 5.0, 5.0])
OVERLAP_MARGIN = 0.5  # metres: a segment may lie this far beyond what is known of a wall and still count as seen there
CAUCHY_SCALE = 3.0  # standard deviations at which an observation counts half


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """The outcome: the base's `pose` in the map, its `information` (3, 3) in the base's frame from walls alone,
    the landmark each segment fell on (`matches` (n,), -1 for none), and the share of the scan's wall length explained."""

    pose: se2.Pose
    information: Floats
    matches: NDArray[np.int64]
    explained: float
    seen: float


@njit(cache=True)
def _match(pose, frames, halves, covariances, walls, lows, highs, offset_gate, heading_gate, floor, matches):  # type: ignore[no-untyped-def]
    """Pair each segment with the nearest wall inside the gates, and accumulate the normal equations."""
    information, gradient = np.zeros((3, 3)), np.zeros(3)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    explained = 0.0
    for i in range(len(frames)):
        matches[i] = -1
        x = pose[0] + c * frames[i, 0] - s * frames[i, 1]
        y = pose[1] + s * frames[i, 0] + c * frames[i, 1]
        syy = covariances[i, 0, 0] + floor[0]
        stt = covariances[i, 1, 1] + floor[1]
        syt = covariances[i, 0, 1]
        determinant = syy * stt - syt * syt
        wyy, wtt, wyt = stt / determinant, syy / determinant, -syt / determinant
        best = np.inf
        overlap = by = bt = 0.0
        for j in range(len(walls)):
            turn = pose[2] + frames[i, 2] - walls[j, 2]
            turn -= 2 * math.pi * math.floor((turn + math.pi) / (2 * math.pi))
            if abs(turn) > heading_gate:
                continue
            wc, ws = math.cos(walls[j, 2]), math.sin(walls[j, 2])
            dx, dy = x - walls[j, 0], y - walls[j, 1]
            offset = -ws * dx + wc * dy
            if abs(offset) > offset_gate:
                continue
            along = wc * dx + ws * dy
            low, high = along - halves[i], along + halves[i]
            shared = min(high, highs[j] + OVERLAP_MARGIN) - max(low, lows[j] - OVERLAP_MARGIN)
            if shared <= 0.0:
                continue
            distance = (offset / offset_gate) ** 2 + (turn / heading_gate) ** 2
            if distance < best:
                best, overlap, by, bt = distance, min(shared, 2 * halves[i]), offset, turn
                matches[i] = j
        if matches[i] < 0:
            continue
        j = matches[i]
        wc, ws = math.cos(walls[j, 2]), math.sin(walls[j, 2])
        chi2 = wyy * by * by + 2 * wyt * by * bt + wtt * bt * bt
        weight = 1.0 / (1.0 + chi2 / (CAUCHY_SCALE * CAUCHY_SCALE))
        explained += overlap * (1.0 - 0.5 * best / 2.0)
        # change of the offset with the base moving (dx, dy) and turning in its own frame
        jx = -ws * c + wc * s
        jy = ws * s + wc * c
        lever_x, lever_y = x - pose[0], y - pose[1]
        jt = ws * lever_y + wc * lever_x
        j0, j1, j2 = jx, jy, jt
        information[0, 0] += weight * wyy * j0 * j0
        information[0, 1] += weight * wyy * j0 * j1
        information[1, 1] += weight * wyy * j1 * j1
        information[0, 2] += weight * (wyy * j0 * j2 + wyt * j0)
        information[1, 2] += weight * (wyy * j1 * j2 + wyt * j1)
        information[2, 2] += weight * (wyy * j2 * j2 + 2 * wyt * j2 + wtt)
        ry, rt = wyy * by + wyt * bt, wyt * by + wtt * bt
        gradient[0] += weight * j0 * ry
        gradient[1] += weight * j1 * ry
        gradient[2] += weight * (j2 * ry + rt)
    information[1, 0], information[2, 0], information[2, 1] = (
        information[0, 1],
        information[0, 2],
        information[1, 2],
    )
    return information, gradient, explained


@njit(cache=True)
def _register(
    prediction,
    prior,
    frames,
    halves,
    covariances,
    walls,
    lows,
    highs,
    starts,
    offset_gates,
    heading_gates,
    floor,
):  # type: ignore[no-untyped-def]
    best_pose, best_information = prediction.copy(), np.zeros((3, 3))
    best_matches = np.full(len(frames), -1)
    best_explained = -1.0
    matches = np.full(len(frames), -1)
    for start in starts:
        pose = prediction.copy()
        pose[2] += start
        information = np.zeros((3, 3))
        explained = 0.0
        for step in range(len(offset_gates)):
            information, gradient, explained = _match(
                pose,
                frames,
                halves,
                covariances,
                walls,
                lows,
                highs,
                offset_gates[step],
                heading_gates[step],
                floor,
                matches,
            )
            # the prior pulls towards the prediction, weakly: it decides only what walls leave open
            c, s = math.cos(pose[2]), math.sin(pose[2])
            ex, ey = pose[0] - prediction[0], pose[1] - prediction[1]
            error = np.array([c * ex + s * ey, -s * ex + c * ey, pose[2] - prediction[2]])
            step_taken = np.linalg.solve(information + prior, gradient + prior @ error)
            pose[0] -= c * step_taken[0] - s * step_taken[1]
            pose[1] -= s * step_taken[0] + c * step_taken[1]
            pose[2] -= step_taken[2]
        if explained > best_explained + 1e-9:
            best_explained, best_pose, best_information = explained, pose, information
            best_matches = matches.copy()
    return best_pose, best_information, best_matches, best_explained


def register(
    prediction: se2.Pose,
    prior: Floats,
    segments: Segments,
    walls: Floats,
    lows: Floats,
    highs: Floats,
    floor: Floats,
) -> Registration:
    """Lay `segments` over the walls (m, 3 frames in the map, known from `lows` to `highs` along their x axis).

    `prior` (3, 3) is the information of the prediction in the base's frame.
    """
    pose, information, matches, explained = _register(
        prediction,
        prior,
        segments.frame,
        segments.half_length,
        segments.covariance,
        walls,
        lows,
        highs,
        HEADING_STARTS,
        OFFSET_GATES,
        HEADING_GATES,
        floor,
    )
    pose[2] = se2.wrap(pose[2])
    return Registration(pose, information, matches, explained, float(2 * segments.half_length.sum()))
