"""Laying a fragment on a map: Gauss-Newton on all walls from a start given, and how much of them then lies there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from drivers import se2

from ..angles import turn_of
from ..segments import Floats
from .constellation import Integers
from .scene import Scene

GATES = np.array([0.8, 0.6, 0.45, 0.3, 0.25, 0.2, 0.2])  # metres across, one a Gauss-Newton step; the last one judges
TURN_GATES = np.radians([12.0, 10.0, 8.0, 7.0, 6.0, 6.0, 6.0])
SIGMA = 0.03  # metres, by which the same wall differs between two maps of a place, beyond what either knows of it
SAMPLE = 0.1  # metres of wall between the points that are looked up in the map
BEYOND = 0.15  # metres beyond what was seen of a wall where it may go on
CORNER_GATE, CORNER_TURN = 0.3, math.radians(20.0)  # metres and radians by which corners that are one may differ


@dataclass(frozen=True, slots=True, eq=False)
class Laid:
    """A fragment laid on a map.

    place        [x, y, heading] of the fragment's frame in the map
    information  (3, 3) of it, in the map's axes about the frame's origin, from the covariances of the walls that lie
                 on each other
    matches      (n,) row of the map's wall for each wall of the fragment, -1 for none
    length       metres of the fragment's walls that lie on the map's
    explained    share of them that do
    corners      the fragment's corners that are corners of the map
    """

    place: se2.Pose
    information: Floats
    matches: Integers
    length: float
    explained: float
    corners: int


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Points on a fragment's walls: walls (p,), and metres along (p,) from the wall's frame."""

    wall: Integers
    along: Floats


def samples_of(scene: Scene) -> Samples:
    """A point every SAMPLE metres of what was seen of the walls."""
    counts = np.maximum(1, np.round((scene.stretches[:, 1] - scene.stretches[:, 0]) / SAMPLE)).astype(np.int64)
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    along = np.repeat(scene.stretches[:, 0], counts) + (within + 0.5) * SAMPLE
    return Samples(np.repeat(scene.stretch_wall, counts), along)


def lay(start: se2.Pose, fragment: Scene, samples: Samples, scene: Scene) -> Laid:
    """The best place near `start`, as in `Laid`."""
    first = np.searchsorted(scene.stretch_wall, np.arange(len(scene) + 1))
    place, information, matches, on_map = _lay(
        start, fragment.frame, fragment.half_length, fragment.covariance, samples.wall, samples.along,
        scene.frame, scene.half_length, scene.covariance, scene.stretches, first,
    )  # fmt: skip
    place[2] = se2.wrap(place[2])
    length, explained = on_map * SAMPLE, on_map / max(1, len(samples.wall))
    return Laid(place, information, matches, length, explained, _corners(place, fragment, scene))


def _corners(place: se2.Pose, fragment: Scene, scene: Scene) -> int:
    if not len(fragment.corners) or not len(scene.corners):
        return 0
    moved = se2.transform(place, fragment.corners).reshape(-1, 2)
    near = np.hypot(*np.moveaxis(moved[:, None] - scene.corners, -1, 0)) < CORNER_GATE
    turned = np.abs(se2.wrap(fragment.headings[:, None] + place[2] - scene.headings)).max(axis=-1)
    return int((near & (turned < CORNER_TURN)).any(axis=1).sum())


@njit(cache=True)
def _lay(  # type: ignore[no-untyped-def]
    start, frames, halves, covariances, sample_walls, samples,
    walls, wall_halves, wall_covariances, stretches, first,
):  # fmt: skip
    place = start.copy()
    matches = np.full(len(frames), -1)
    information = np.zeros((3, 3))
    on_map = np.zeros(len(samples), dtype=np.bool_)
    sample_first = np.searchsorted(sample_walls, np.arange(len(frames) + 1))
    for step in range(len(GATES)):
        last = step == len(GATES) - 1
        information, gradient = np.eye(3) * 1e-3, np.zeros(3)
        c, s = math.cos(place[2]), math.sin(place[2])
        for i in range(len(frames)):
            lever_x, lever_y = c * frames[i, 0] - s * frames[i, 1], s * frames[i, 0] + c * frames[i, 1]
            x, y = place[0] + lever_x, place[1] + lever_y
            most, matches[i] = 0.0, -1
            for j in range(len(walls)):
                turned = turn_of(frames[i, 2] + place[2] - walls[j, 2])
                if abs(turned) > TURN_GATES[step]:
                    continue
                wc, ws = math.cos(walls[j, 2]), math.sin(walls[j, 2])
                along, across = (
                    wc * (x - walls[j, 0]) + ws * (y - walls[j, 1]),
                    wc * (y - walls[j, 1]) - ws * (x - walls[j, 0]),
                )
                low, high = max(along - halves[i], -wall_halves[j]), min(along + halves[i], wall_halves[j])
                if high <= low:
                    continue
                shared = 0.5 * (low + high) - along  # where along the fragment's wall the two lie side by side
                offset = across + shared * math.sin(turned)
                if abs(offset) > GATES[step]:
                    continue
                if last:
                    for k in range(sample_first[i], sample_first[i + 1]):
                        at = along + samples[k] * math.cos(turned)
                        for p in range(first[j], first[j + 1]):
                            if stretches[p, 0] - BEYOND < at < stretches[p, 1] + BEYOND:
                                on_map[k] = True
                if high - low > most:
                    most, matches[i] = high - low, j
                # what either knows of its wall where they lie side by side, and what places differ by between two maps
                own, other, reach = covariances[i], wall_covariances[j], along + shared
                v00 = own[0, 0] + 2 * shared * own[0, 1] + shared**2 * own[1, 1] + SIGMA**2
                v00 += other[0, 0] + 2 * reach * other[0, 1] + reach**2 * other[1, 1]
                v01 = own[0, 1] + shared * own[1, 1] + other[0, 1] + reach * other[1, 1]
                v11 = own[1, 1] + other[1, 1] + 12 * SIGMA**2 / max(high - low, SAMPLE) ** 2
                trust = (1 - (offset / GATES[step]) ** 2) * (1 - (turned / TURN_GATES[step]) ** 2)
                trust = trust * trust / (v00 * v11 - v01 * v01)
                nx, ny = -ws, wc
                px, py = (
                    lever_x + shared * math.cos(frames[i, 2] + place[2]),
                    lever_y + shared * math.sin(frames[i, 2] + place[2]),
                )
                row = np.array([nx, ny, px * ny - py * nx])
                for p in range(3):
                    weighted = trust * (v11 * row[p] - (v01 if p == 2 else 0.0))
                    cross = trust * ((v00 if p == 2 else 0.0) - v01 * row[p])
                    gradient[p] += weighted * offset + cross * turned
                    for q in range(3):
                        information[p, q] += weighted * row[q]
                    information[p, 2] += cross
        if not last:
            place = place - np.linalg.solve(information, gradient)
    return place, information, matches, on_map.sum()
