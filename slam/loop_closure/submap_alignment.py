"""Laying a fragment on a map: Gauss-Newton on all walls from a start given, and how much of them then lies there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from drivers import se2

from ..geometry.angles import turn_of
from ..geometry.segments import Floats, Integers
from .map_descriptor import MapDescriptor

GATES = np.array([0.8, 0.6, 0.45, 0.3, 0.25, 0.2, 0.2])  # metres across, one a Gauss-Newton step; the last one judges
TURN_GATES = np.radians([12.0, 10.0, 8.0, 7.0, 6.0, 6.0, 6.0])
SIGMA = 0.03  # metres, by which the same wall differs between two maps of a place, beyond what either knows of it
SAMPLE = 0.1  # metres of wall between the points that are looked up in the map
BEYOND = 0.15  # metres beyond what was seen of a wall where it may go on
LEAST_INFORMATION = 1e-3  # per square metre and radian: keeps the solution finite where walls leave a direction open
STRAY = 1.5  # metres by which Gauss-Newton may move the fragment, at most
CORNER_GATE, CORNER_TURN = 0.3, math.radians(20.0)  # metres and radians by which corners that are one may differ


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """A fragment laid on a map.

    place        [x, y, heading] of the fragment's frame in the map
    information  (3, 3) of it, in the map's axes about the frame's origin, from the covariances of the walls that lie
                 on each other
    matches      (n,) row of the map's wall for each wall of the fragment, -1 for none
    seen         (n,) metres that were seen of each wall of the fragment
    on_map       (n,) metres of them that lie on the map's walls
    corners      the fragment's corners that are corners of the map
    """

    place: se2.Pose
    information: Floats
    matches: Integers
    seen: Floats
    on_map: Floats
    corners: int

    @property
    def length(self) -> float:
        """Metres of the fragment's walls that lie on the map's."""
        return float(self.on_map.sum())


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Points on a fragment's walls: walls (p,), and metres along (p,) from the wall's frame."""

    wall: Integers
    along: Floats


def samples_of(scene: MapDescriptor) -> Samples:
    """A point every SAMPLE metres of what was seen of the walls."""
    counts = np.maximum(1, np.round((scene.stretches[:, 1] - scene.stretches[:, 0]) / SAMPLE)).astype(np.int64)
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    along = np.repeat(scene.stretches[:, 0], counts) + (within + 0.5) * SAMPLE
    return Samples(np.repeat(scene.stretch_wall, counts), along)


def align_submap(start: se2.Pose, fragment: MapDescriptor, samples: Samples, scene: MapDescriptor) -> Alignment:
    """The best place near `start`, as in `Laid`."""
    first = np.searchsorted(scene.stretch_wall, np.arange(len(scene) + 1))
    place, information, matches, on_map = _align_submap(
        start, fragment.frame, fragment.half_length, fragment.covariance, samples.wall, samples.along,
        scene.frame, scene.half_length, scene.covariance, scene.stretches, first,
    )  # fmt: skip
    place[2] = se2.wrap(place[2])
    seen, lies = np.zeros(len(fragment)), np.zeros(len(fragment))
    np.add.at(seen, samples.wall, SAMPLE)
    np.add.at(lies, samples.wall, SAMPLE * on_map)
    return Alignment(place, information, matches, seen, lies, _corners(place, fragment, scene))


def _corners(place: se2.Pose, fragment: MapDescriptor, scene: MapDescriptor) -> int:
    if not len(fragment.corners) or not len(scene.corners):
        return 0
    moved = se2.transform(place, fragment.corners).reshape(-1, 2)
    near = np.hypot(*np.moveaxis(moved[:, None] - scene.corners, -1, 0)) < CORNER_GATE
    turned = np.abs(se2.wrap(fragment.headings[:, None] + place[2] - scene.headings)).max(axis=-1)
    return int((near & (turned < CORNER_TURN)).any(axis=1).sum())


@njit(cache=True)
def _align_submap(  # type: ignore[no-untyped-def]
    start, frames, halves, covariances, sample_walls, samples,
    walls, wall_halves, wall_covariances, stretches, first,
):  # fmt: skip
    """The place, its information, the matches, and which samples lie on the map."""
    place, information, on_map = start.copy(), np.zeros((3, 3)), np.zeros(len(samples), dtype=np.bool_)
    matches, most = np.full(len(frames), -1), np.zeros(len(frames))
    own_first = np.searchsorted(sample_walls, np.arange(len(frames) + 1))
    near = _near(start, frames, halves, walls, wall_halves)
    for step in range(len(GATES)):
        last = step == len(GATES) - 1
        information, gradient = np.eye(3) * LEAST_INFORMATION, np.zeros(3)
        c, s = math.cos(place[2]), math.sin(place[2])
        for i in range(len(frames)):
            lever = np.array([c * frames[i, 0] - s * frames[i, 1], s * frames[i, 0] + c * frames[i, 1]])
            heading = frames[i, 2] + place[2]
            for j in near:
                turned = turn_of(heading - walls[j, 2])
                if abs(turned) > TURN_GATES[step]:
                    continue
                nx, ny = -math.sin(walls[j, 2]), math.cos(walls[j, 2])
                dx, dy = place[0] + lever[0] - walls[j, 0], place[1] + lever[1] - walls[j, 1]
                along, across = ny * dx - nx * dy, nx * dx + ny * dy
                low, high = max(along - halves[i], -wall_halves[j]), min(along + halves[i], wall_halves[j])
                shared = 0.5 * (low + high) - along  # where along the fragment's wall the two lie side by side
                offset = across + shared * math.sin(turned)
                if high <= low or abs(offset) > GATES[step]:
                    continue
                variance = _variance(covariances[i], shared, wall_covariances[j], along + shared, high - low)
                trust = (1 - (offset / GATES[step]) ** 2) * (1 - (turned / TURN_GATES[step]) ** 2)  # Tukey's
                weight = trust**2 * np.linalg.inv(variance)
                px, py = lever[0] + shared * math.cos(heading), lever[1] + shared * math.sin(heading)
                jacobian = np.array([[nx, ny, px * ny - py * nx], [0.0, 0.0, 1.0]])
                information += jacobian.T @ weight @ jacobian
                gradient += jacobian.T @ weight @ np.array([offset, turned])
                if not last:
                    continue
                _mark(
                    on_map, samples, own_first[i], own_first[i + 1], along, turned, stretches[first[j] : first[j + 1]]
                )
                if high - low > most[i]:
                    most[i], matches[i] = high - low, j
        if not last:
            place -= np.linalg.solve(information, gradient)
    return place, information, matches, on_map


@njit(cache=True)
def _near(start, frames, halves, walls, wall_halves):  # type: ignore[no-untyped-def]
    """Rows of the map's walls that a fragment around `start` may come to lie on."""
    reach = STRAY
    for i in range(len(frames)):
        reach = max(reach, STRAY + math.hypot(frames[i, 0], frames[i, 1]) + halves[i])
    near = np.zeros(len(walls), dtype=np.bool_)
    for j in range(len(walls)):
        near[j] = math.hypot(walls[j, 0] - start[0], walls[j, 1] - start[1]) - wall_halves[j] < reach
    return np.flatnonzero(near)


@njit(cache=True)
def _variance(own, at, other, there, length):  # type: ignore[no-untyped-def]
    """(2, 2) of offset and heading between two walls where they lie side by side, `at` and `there` from their frames:
    of what either knows of its own, and of what places differ by between two maps."""
    v00 = own[0, 0] + 2 * at * own[0, 1] + at**2 * own[1, 1]
    v00 += other[0, 0] + 2 * there * other[0, 1] + there**2 * other[1, 1]
    v01 = own[0, 1] + at * own[1, 1] + other[0, 1] + there * other[1, 1]
    v11 = own[1, 1] + other[1, 1] + 12 * SIGMA**2 / max(length, SAMPLE) ** 2
    return np.array([[v00 + SIGMA**2, v01], [v01, v11]])


@njit(cache=True)
def _mark(on_map, samples, begin, end, along, turned, stretches):  # type: ignore[no-untyped-def]
    """Mark the samples of a wall, its frame `along` metres from that of a map's wall, that lie on its stretches."""
    for k in range(begin, end):
        at = along + samples[k] * math.cos(turned)
        for p in range(len(stretches)):
            if stretches[p, 0] - BEYOND < at < stretches[p, 1] + BEYOND:
                on_map[k] = True
