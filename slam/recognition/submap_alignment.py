"""Alignment of a submap with a map: Gauss-Newton on all walls from a start, and the wall length that matches then."""

from __future__ import annotations

import math

import numpy as np

from drivers import se2
from drivers.compiled import compiled, inlined
from drivers.immutable import immutable
from drivers.small_matrices import solve

from ..geometry.angles import wrap_angle
from ..geometry.segments import Floats, Integers
from ..loop_closure.submap_search import DISTINCT_SHIFT
from ..mapping.wall_cells import END_ERROR_CELLS, WALL_CELL
from ..matching.scan_points import FINE_SIGMA
from .map_descriptor import MapDescriptor

# Metres across between two matched walls, for each Gauss-Newton step; the last step only scores.
# Origin: chosen, from the cells of the pose votes to the accuracy of a submap; not measured.
SUBMAP_OFFSET_GATES = np.array([0.8, 0.6, 0.45, 0.3, 0.25, 0.2, 0.2])
# Radians between two matched walls, for each Gauss-Newton step. Origin: chosen, likewise; not measured.
SUBMAP_HEADING_GATES = np.radians([12.0, 10.0, 8.0, 7.0, 6.0, 6.0, 6.0])
# Per square metre and per square radian: regularises the solution if the walls leave a direction undetermined.
# Origin: numerical.
ALIGNMENT_REGULARISATION = 1e-3
# Metres by which Gauss-Newton may move the submap; bounds the walls that are considered. Origin: definition, the
# neighbourhood of a cell of poses, in which votes are summed.
MAX_ALIGNMENT_SHIFT = 3.0 * DISTINCT_SHIFT


@immutable
class Alignment:
    """Submap aligned with a map.

    pose         [x, y, heading] of the submap's frame in the map
    information  (3, 3) of the pose from the covariances of the matched walls, in the map's axes
    matches      (n,) row of the map's wall for each wall of the submap, -1 for none
    observed     (n,) observed metres of each wall of the submap
    on_map       (n,) metres of them that lie on walls of the map
    """

    pose: se2.Pose
    information: Floats
    matches: Integers
    observed: Floats
    on_map: Floats

    @property
    def length(self) -> float:
        """Metres of the submap's walls that lie on walls of the map."""
        return float(self.on_map.sum())


@immutable
class WallSamples:
    """p points on a submap's walls: row of the wall (p,), and metres along it from its frame (p,)."""

    wall: Integers
    along: Floats


def sample_walls(descriptor: MapDescriptor) -> WallSamples:
    """Return a point every WALL_CELL metres of the observed stretches."""
    counts = np.maximum(1, np.round((descriptor.stretches[:, 1] - descriptor.stretches[:, 0]) / WALL_CELL)).astype(
        np.int64
    )
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    along = np.repeat(descriptor.stretches[:, 0], counts) + (within + 0.5) * WALL_CELL
    return WallSamples(np.repeat(descriptor.stretch_wall, counts), along)


def align_submap(start: se2.Pose, submap: MapDescriptor, samples: WallSamples, descriptor: MapDescriptor) -> Alignment:
    """Align a submap with the map of `descriptor`, starting with the submap's frame at `start` in the map."""
    first = np.searchsorted(descriptor.stretch_wall, np.arange(len(descriptor) + 1))
    own_first = np.searchsorted(samples.wall, np.arange(len(submap) + 1))
    pose, information, matches, on_map = _align_submap(
        start, submap.frame, submap.half_length, submap.covariance, own_first, samples.along,
        descriptor.frame, descriptor.half_length, descriptor.covariance, descriptor.stretches, first,
    )  # fmt: skip
    pose[2] = se2.wrap(pose[2])
    spacings = np.full(len(samples.wall), WALL_CELL)
    observed = np.asarray(np.bincount(samples.wall, spacings, len(submap)), dtype=np.float64)
    matched = np.asarray(np.bincount(samples.wall, spacings * on_map, len(submap)), dtype=np.float64)
    return Alignment(pose, information, matches, observed, matched)


@compiled
def _align_submap(  # type: ignore[no-untyped-def]
    start, frames, halves, covariances, own_first, samples,
    walls, wall_halves, wall_covariances, stretches, first,
):  # fmt: skip
    """Run Gauss-Newton; returns the pose, its information, the matches, and which samples lie on the map.

    own_first  (n + 1,) the first sample of each wall of the submap, and the number of samples
    """
    pose, information, on_map = start.copy(), np.zeros((3, 3)), np.zeros(len(samples), dtype=np.bool_)
    matches, most = np.full(len(frames), -1), np.zeros(len(frames))
    near = _find_near_walls(start, frames, halves, walls, wall_halves)
    for step in range(len(SUBMAP_OFFSET_GATES)):
        last = step == len(SUBMAP_OFFSET_GATES) - 1
        offset_gate, heading_gate = SUBMAP_OFFSET_GATES[step], SUBMAP_HEADING_GATES[step]
        information, gradient = np.zeros((3, 3)), np.zeros(3)
        for k in range(3):
            information[k, k] = ALIGNMENT_REGULARISATION
        c, s = math.cos(pose[2]), math.sin(pose[2])
        for i in range(len(frames)):
            lever_x, lever_y = c * frames[i, 0] - s * frames[i, 1], s * frames[i, 0] + c * frames[i, 1]
            heading = frames[i, 2] + pose[2]
            for j in near:
                turned = wrap_angle(heading - walls[j, 2])
                if abs(turned) > heading_gate:
                    continue
                along, low, high, shared, offset = _overlap(
                    pose[0] + lever_x, pose[1] + lever_y, turned, halves[i], walls[j], wall_halves[j]
                )
                if high <= low or abs(offset) > offset_gate:
                    continue
                weight = ((1 - (offset / offset_gate) ** 2) * (1 - (turned / heading_gate) ** 2)) ** 2  # Tukey's
                pair = _relative_information(covariances[i], shared, wall_covariances[j], along + shared, high - low)
                px, py = lever_x + shared * math.cos(heading), lever_y + shared * math.sin(heading)
                _add_pair(information, gradient, weight, pair, px, py, walls[j, 2], offset, turned)
                if last:
                    ends = stretches[first[j] : first[j + 1]]
                    _mark_matched_samples(on_map, samples, own_first[i], own_first[i + 1], along, turned, ends)
                    if high - low > most[i]:
                        most[i], matches[i] = high - low, j
        information[1, 0], information[2, 0] = information[0, 1], information[0, 2]
        information[2, 1] = information[1, 2]
        if not last:
            pose -= solve(information, gradient)
    return pose, information, matches, on_map


@inlined
def _overlap(x, y, turned, half, wall, wall_half):  # type: ignore[no-untyped-def]
    """Compare a wall of the submap, whose frame is at (x, y) in the map and turned from that of the map's wall.

    Returns metres: along the map's wall from its frame to the other one, and to both ends of the overlap (low is
    greater without one); along the submap's wall from its frame to the middle of the overlap; and the offset there.
    """
    nx, ny = -math.sin(wall[2]), math.cos(wall[2])
    dx, dy = x - wall[0], y - wall[1]
    along, across = ny * dx - nx * dy, nx * dx + ny * dy
    low, high = max(along - half, -wall_half), min(along + half, wall_half)
    shared = 0.5 * (low + high) - along
    return along, low, high, shared, across + shared * math.sin(turned)


@inlined
def _add_pair(  # type: ignore[no-untyped-def]
    information, gradient, weight, pair, px, py, direction, offset, turned
):
    """Add a pair of walls to the normal equations of the pose.

    pair              its information on offset and heading, see `_relative_information`
    px, py            from the submap's origin to the middle of the overlap, in the map's axes
    direction         of the map's wall
    offset, turned    of the submap's wall relative to it
    """
    w_across, w_both, w_turn = pair
    nx, ny = -math.sin(direction), math.cos(direction)
    by_turn = px * ny - py * nx  # the derivatives of the offset by the pose are (nx, ny, by_turn)
    both = w_across * by_turn + w_both
    information[0, 0] += weight * w_across * nx * nx
    information[0, 1] += weight * w_across * nx * ny
    information[1, 1] += weight * w_across * ny * ny
    information[0, 2] += weight * both * nx
    information[1, 2] += weight * both * ny
    information[2, 2] += weight * (both * by_turn + w_both * by_turn + w_turn)
    force = weight * (w_across * offset + w_both * turned)
    gradient[0] += force * nx
    gradient[1] += force * ny
    gradient[2] += force * by_turn + weight * (w_both * offset + w_turn * turned)


@compiled
def _find_near_walls(start, frames, halves, walls, wall_halves):  # type: ignore[no-untyped-def]
    """Return the rows of the map's walls that a submap started at `start` may be matched with."""
    reach = MAX_ALIGNMENT_SHIFT
    for i in range(len(frames)):
        reach = max(reach, MAX_ALIGNMENT_SHIFT + math.hypot(frames[i, 0], frames[i, 1]) + halves[i])
    near = np.zeros(len(walls), dtype=np.bool_)
    for j in range(len(walls)):
        near[j] = math.hypot(walls[j, 0] - start[0], walls[j, 1] - start[1]) - wall_halves[j] < reach
    return np.flatnonzero(near)


@compiled
def _relative_information(own, at, other, there, length):  # type: ignore[no-untyped-def]
    """Return the information on offset and heading between two walls at the middle of their overlap.

    That is the inverse of the covariance (2, 2): of the offset, of both, and of the heading.
    `at` and `there` are metres from the walls' frames to it, `length` is that of the overlap.
    """
    v00 = own[0, 0] + 2 * at * own[0, 1] + at**2 * own[1, 1]
    v00 += other[0, 0] + 2 * there * other[0, 1] + there**2 * other[1, 1]
    v01 = own[0, 1] + at * own[1, 1] + other[0, 1] + there * other[1, 1]
    v11 = own[1, 1] + other[1, 1] + 12 * FINE_SIGMA**2 / max(length, WALL_CELL) ** 2
    v00 += FINE_SIGMA**2
    determinant = v00 * v11 - v01 * v01
    return v11 / determinant, -v01 / determinant, v00 / determinant


@compiled
def _mark_matched_samples(on_map, samples, begin, end, along, turned, stretches):  # type: ignore[no-untyped-def]
    """Mark the samples of a wall that lie on the stretches of a map's wall, whose frame is `along` metres away."""
    for k in range(begin, end):
        at, margin = along + samples[k] * math.cos(turned), END_ERROR_CELLS * WALL_CELL
        for p in range(len(stretches)):
            if stretches[p, 0] - margin < at < stretches[p, 1] + margin:
                on_map[k] = True
