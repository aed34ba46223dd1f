"""Normal equations of a scan's segments and corners at the walls and corners of the map."""

from __future__ import annotations

import math
from typing import NamedTuple

from drivers.compiled import inlined
from features.normal_limits import NORMAL_LIMIT

from ..geometry.angles import wrap_angle
from ..geometry.roughness import wall_weights
from ..geometry.segments import Floats
from ..mapping.data_association import MAX_CORNER_HEADING_DIFFERENCE
from ..mapping.wall_cells import MIN_GAP_BETWEEN_PIECES

# Metres beyond the known end of a wall in which a segment still overlaps with it, as walls continue beyond what was
# seen of them. Origin: definition, so near it is of the same piece of the wall.
MATCH_END_MARGIN = MIN_GAP_BETWEEN_PIECES
# Scale of the Cauchy kernel, standard deviations: an observation or prediction this far off has half weight.
# Origin: definition, the limit of normal errors.
MATCH_CAUCHY_SCALE = NORMAL_LIMIT


class SegmentArrays(NamedTuple):
    """Arrays of `Segments`."""

    frame: Floats
    half_length: Floats
    covariance: Floats


class CornerArrays(NamedTuple):
    """Arrays of the corners of a scan or of the map: position (n, 2), headings (n, 2), covariance (n, 2, 2)."""

    position: Floats
    headings: Floats
    covariance: Floats


class WallArrays(NamedTuple):
    """Arrays of the walls of a `LocalMap`; axis (n, 2) is the unit vector along each."""

    frame: Floats
    axis: Floats
    low: Floats
    high: Floats
    covariance: Floats


@inlined
def add_walls(  # type: ignore[no-untyped-def]
    pose, segments, walls, roughness, offset_gate, heading_gate, overlaps, information, gradient
):
    """Pair each segment with the nearest wall inside the gates and add its normal equations.

    pose                       (3,) of the base in the map
    roughness                  variances (2,) of the walls, see `Roughness`
    offset_gate, heading_gate  metres across and radians between a segment and its wall
    information, gradient      (3, 3) and (3,) of the base's pose, in its own axes: the equations are added to them

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
        wyy, wyt, wtt = wall_weights(
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


@inlined
def _match_segment(x, y, heading, half, walls, offset_gate, heading_gate):  # type: ignore[no-untyped-def]
    """Match a segment at (x, y, heading) in the map with the nearest wall inside the gates.

    Returns the wall's row (-1 for none), the squared distance relative to the gates, the overlap in metres, the offset,
    the heading difference, and the position along the wall.
    """
    best, match = 2.0, -1  # the largest distance inside the gates
    overlap = offset = turn = along = 0.0
    for j in range(len(walls.frame)):
        wc, ws = walls.axis[j, 0], walls.axis[j, 1]
        dx, dy = x - walls.frame[j, 0], y - walls.frame[j, 1]
        across = wc * dy - ws * dx
        if abs(across) > offset_gate:  # as of most walls
            continue
        angle = wrap_angle(heading - walls.frame[j, 2])
        if abs(angle) > heading_gate:
            continue
        at = wc * dx + ws * dy
        shared = min(at + half, walls.high[j] + MATCH_END_MARGIN) - max(at - half, walls.low[j] - MATCH_END_MARGIN)
        distance = (across / offset_gate) ** 2 + (angle / heading_gate) ** 2
        if shared > 0.0 and distance < best:
            best, match, overlap, offset, turn, along = distance, j, min(shared, 2 * half), across, angle, at
    return match, best, overlap, offset, turn, along


@inlined
def add_corners(  # type: ignore[no-untyped-def]
    pose, observed, corners, roughness, gate, information, gradient
):
    """Pair each observed corner with the nearest map corner inside the gate and add its normal equations.

    gate  metres between two corners; for the other arguments see `add_walls`
    """
    points, headings = observed.position, observed.headings
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for i in range(len(points)):
        lever_x, lever_y = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
        best, match = gate * gate, -1
        for j in range(len(corners.position)):
            dx, dy = pose[0] + lever_x - corners.position[j, 0], pose[1] + lever_y - corners.position[j, 1]
            distance = dx * dx + dy * dy
            if (
                distance < best
                and abs(wrap_angle(pose[2] + headings[i, 0] - corners.headings[j, 0])) < MAX_CORNER_HEADING_DIFFERENCE
                and abs(wrap_angle(pose[2] + headings[i, 1] - corners.headings[j, 1])) < MAX_CORNER_HEADING_DIFFERENCE
            ):
                best, match = distance, j
        if match < 0:
            continue
        wxx, wxy, wyy = _corner_weights(observed.covariance[i], corners.covariance[match], c, s, roughness)
        dx, dy = pose[0] + lever_x - corners.position[match, 0], pose[1] + lever_y - corners.position[match, 1]
        chi2 = wxx * dx * dx + 2.0 * wxy * dx * dy + wyy * dy * dy
        # Half weight: a corner is computed from the ends of two segments that are already matched to walls.
        weight = 0.5 / (1.0 + chi2 / (MATCH_CAUCHY_SCALE * MATCH_CAUCHY_SCALE))
        wxx, wxy, wyy = weight * wxx, weight * wxy, weight * wyy
        # derivatives of the corner's position with respect to moving forward, left, and turning
        derivatives = ((c, s), (-s, c), (-lever_y, lever_x))
        for k in range(3):
            of_x, of_y = derivatives[k]
            x, y = wxx * of_x + wxy * of_y, wxy * of_x + wyy * of_y
            gradient[k] += x * dx + y * dy
            for m in range(3):
                information[k, m] += x * derivatives[m][0] + y * derivatives[m][1]


@inlined
def _corner_weights(corner, known, c, s, roughness):  # type: ignore[no-untyped-def]
    """Return the information (xx, xy, yy) of the position of a corner relative to that of the map, in the map's axes.

    `corner` and `known` are the covariances (2, 2) of both, the first in the axes of a base with the heading's cosine
    `c` and sine `s`.
    """
    xx, xy, yy = corner[0, 0], corner[0, 1], corner[1, 1]
    of_x = c * c * xx - 2.0 * c * s * xy + s * s * yy + known[0, 0] + roughness[0]
    of_y = s * s * xx + 2.0 * c * s * xy + c * c * yy + known[1, 1] + roughness[0]
    both = c * s * (xx - yy) + (c * c - s * s) * xy + known[0, 1]
    determinant = of_x * of_y - both * both
    return of_y / determinant, -both / determinant, of_x / determinant
