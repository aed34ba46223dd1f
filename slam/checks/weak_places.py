"""Find weak places: where a map is poorly known by its own covariances, and the drive that would improve it.

The standard deviations are relative to the origin of the map, the pose of the first keyframe. Along the path they grow
where each place is known only relative to the one before it, and closed loops and returns make them smaller again. So a
stretch of the path that is poorly known is improved by a drive from its least known place to a place that is well
known, by a way that was not driven yet. If most of the error arises at one place, driving there again improves it.

Walls are compared with the keyframe nearest to them: the error that both share is that of the path. What a wall has
beyond it is due to few or distant observations, and is improved by driving past the wall again.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

import numpy as np

from drivers.immutable import immutable

from ..geometry.segments import Floats, Integers
from ..geometry.surroundings import ROOM_SIZE
from ..mapping.map_features import MapWalls
from .row_groups import MAX_GAP, consecutive_groups

# Metres: standard deviation from which on a place counts as poorly known. Origin: chosen, what a robot of the width of
# most doors has to spare; not measured.
MAX_SIGMA = 0.05
# Metres: standard deviation of a wall beyond that of the path from which on the wall counts as poorly known.
# Origin: measured, none of the 1271 walls of the Intel, CSAIL and FR079 recordings exceeds it, and one exceeds 0.02.
MAX_WALL_SIGMA = 0.03
# Share of MAX_SIGMA below which a place counts as well known. Origin: chosen, so that the drive is worth it.
TARGET_SHARE = 0.5
# Metres: shortest stretch of path, and shortest wall with few observations, that is worth a drive.
# Origin: chosen; not measured.
MIN_LENGTH = 1.0
# Share of the variance whose shortest stretch of path is stated as its source. Origin: definition.
SOURCE_SHARE = 0.5
# Metres: length up to which the source of the variance is one place. Origin: chosen; not measured.
MAX_SOURCE_LENGTH = 10.0
# Metres: two passages of one place are nearer than this, with more driving than that between them.
# Origin: chosen, the width of a corridor, and a way that is not turning on the spot; not measured.
PASSAGE_DISTANCE, PASSAGE_TRAVEL = 1.5, 10.0
# Metres: parts of the map that begin one after the other within this distance are one place.
# Origin: definition, one drive in a room joins them.
PARTS_DISTANCE = ROOM_SIZE
# Keyframes that observe a wall at least if it is well observed. Origin: definition, two confirm it only.
MIN_OBSERVATIONS = 3


class WeakKind(StrEnum):
    """Kinds of weak places.

    PART     of the map that is not joined with the rest
    STRETCH  of the path, poorly known relative to the origin
    WALL     poorly known relative to the path, or observed by two keyframes only
    """

    PART = "part"
    STRETCH = "stretch"
    WALL = "wall"


@immutable
class KeyframePath:
    """Where k keyframes are, and how well that is known.

    stamps     (k,) seconds
    positions  (k, 2) in the map, metres
    sigma      (k,) standard deviation of each position in its most uncertain direction, metres; NaN if unknown
    """

    stamps: Floats
    positions: Floats
    sigma: Floats

    def travelled(self) -> Floats:
        """Return (k,) the metres driven up to each keyframe."""
        steps = np.hypot(*np.diff(self.positions, axis=0).T)
        return np.concatenate([np.zeros(min(1, len(self.positions))), np.cumsum(steps)])

    def nearest(self, point: Floats, rows: Integers | None = None) -> int:
        """Return the keyframe nearest to a point (2,), of all or of some rows."""
        x, y = (self.positions if rows is None else self.positions[rows]).T
        nearest = int(np.argmin((x - point[0]) ** 2 + (y - point[1]) ** 2))
        return nearest if rows is None else int(rows[nearest])


@immutable
class WeakPlace:
    """A place where the map is poorly known.

    kind      kind of the place
    position  (2,) least known point, or source of the error, in the map, metres
    points    (m, 2) the stretch of path or the wall, in the map, metres
    stamp     seconds, when the robot was there
    sigma     standard deviation in metres: of the position, or across the wall; NaN if it is unknown
    target    (2,) place that a drive should lead to from `position`; None if driving at `position` is enough
    text      what is poorly known, without a full stop
    drive     drive that would improve it, without a full stop
    """

    kind: WeakKind
    position: Floats
    points: Floats
    stamp: float
    sigma: float
    target: Floats | None
    text: str
    drive: str


def find_weak_places(walls: MapWalls, path: KeyframePath, parts: Sequence[int] = ()) -> list[WeakPlace]:
    """Return the weak places of a map: parts by time, stretches by their standard deviations, then walls.

    parts  first keyframe of each part of the map that is not joined with the first part
    """
    if not len(path.positions):
        return []
    return [*_parts(path, parts), *_stretches(path), *_walls(walls, path)]


def sigma_across(walls: MapWalls, row: int, along: Floats) -> Floats:
    """Return (n,) the standard deviation across a wall at distances (n,) along it from its frame, metres.

    For the covariance C of offset and heading it is sqrt(C00 + 2 d C01 + d^2 C11) at distance d; NaN if C is unknown.
    """
    c = walls.covariance[row]
    return np.asarray(np.sqrt(np.maximum(c[0, 0] + 2.0 * along * c[0, 1] + along**2 * c[1, 1], 0.0)))


def _parts(path: KeyframePath, parts: Sequence[int]) -> list[WeakPlace]:
    """Return the places where parts begin, of several that begin near each other one."""
    groups: list[list[int]] = []
    for first in parts:
        if not 0 < first < len(path.positions):
            continue
        if groups and np.hypot(*(path.positions[first] - path.positions[groups[-1][0]])) < PARTS_DISTANCE:
            groups[-1].append(first)
        else:
            groups.append([first])
    return [_part(path, group) for group in groups]


def _part(path: KeyframePath, firsts: list[int]) -> WeakPlace:
    """Return the place where parts begin, with the keyframes `firsts`."""
    first, several = firsts[0], len(firsts) > 1
    here = path.positions[first]
    begin = f"{len(firsts)} parts of the map begin near" if several else "A part of the map begins at"
    text = f"{begin} {_place(here)} that {'are' if several else 'is'} not joined with the rest"
    into = "these parts" if several else "this part"
    drive = f"Drive from places that were mapped before into {into}, until they are seen again"
    sigma = float(path.sigma[first])
    return WeakPlace(WeakKind.PART, here, path.positions[firsts], float(path.stamps[first]), sigma, None, text, drive)


def _stretches(path: KeyframePath) -> list[WeakPlace]:
    """Return the stretches of the path whose standard deviation is too large."""
    weak = np.flatnonzero(path.sigma >= MAX_SIGMA)
    known = np.flatnonzero(path.sigma <= TARGET_SHARE * MAX_SIGMA)
    travelled = path.travelled()
    places = []
    for group in consecutive_groups(weak, MAX_GAP):
        rows = np.arange(group[0], group[-1] + 1)
        length = float(np.ptp(travelled[rows]))
        if length < MIN_LENGTH:
            continue
        worst = int(rows[np.nanargmax(path.sigma[rows])])
        once = np.mean([not _passed_again(path, travelled, row) for row in rows.tolist()]) >= SOURCE_SHARE
        sigma = float(path.sigma[worst])
        text = f"{length:.0f} m of the path are known to {_length(sigma)} only" + ", and were driven once" * bool(once)
        first, last = _source(path, travelled, int(group[0]), worst)
        position, target = path.positions[worst], None
        if travelled[last] - travelled[first] <= MAX_SOURCE_LENGTH:
            position = path.positions[[first, last]].mean(axis=0)
            text += (
                f". Most of the error arises within {travelled[last] - travelled[first]:.1f} m at {_place(position)}"
            )
            drive = "Drive there again with walls in view, or connect both sides of it by another way"
        elif len(known):
            nearest = path.nearest(position, known)
            target = path.positions[nearest]
            drive = (
                f"Drive from {_place(position)}, by a way that was not driven yet, to {_place(target)}, which is known "
                f"to {_length(float(path.sigma[nearest]))}, and on until it is recognised"
            )
        else:
            drive = f"Drive from {_place(position)} back to the start by a way that was not driven yet"
        places.append(
            WeakPlace(
                WeakKind.STRETCH, position, path.positions[rows], float(path.stamps[worst]), sigma, target, text, drive
            )
        )
    return sorted(places, key=lambda place: -place.sigma)


def _source(path: KeyframePath, travelled: Floats, first: int, worst: int) -> tuple[int, int]:
    """Return the keyframes around the shortest stretch in which SOURCE_SHARE of the variance at `worst` arises.

    first  first keyframe that is poorly known
    """
    rows = np.flatnonzero(np.isfinite(path.sigma[: worst + 1]))
    rows = rows[max(int(np.searchsorted(rows, first)) - 1, 0) :]  # from the last one that is well known
    variance = path.sigma[rows] ** 2
    best = (int(rows[0]), worst)
    for k, start in enumerate(rows.tolist()):
        grown = np.flatnonzero(variance[k:] - variance[k] >= SOURCE_SHARE * variance[-1])
        if len(grown) and travelled[rows[k + grown[0]]] - travelled[start] < np.diff(travelled[list(best)])[0]:
            best = (start, int(rows[k + grown[0]]))
    return best


def _passed_again(path: KeyframePath, travelled: Floats, row: int) -> bool:
    near = np.hypot(*(path.positions - path.positions[row]).T) <= PASSAGE_DISTANCE
    return bool((near & (np.abs(travelled - travelled[row]) > PASSAGE_TRAVEL)).any())


def _walls(walls: MapWalls, path: KeyframePath) -> list[WeakPlace]:
    """Return the walls that are less known than the path beside them, or observed too rarely, the worst first."""
    places, excess = list[WeakPlace](), list[float]()
    ends = walls.end_points()
    for row in range(len(walls)):
        sigma = sigma_across(walls, row, np.array([walls.low[row], walls.high[row]]))
        if not np.isfinite(sigma).all():
            continue
        beside = [path.nearest(end) for end in ends[row]]
        shared = np.nan_to_num(path.sigma[beside])
        own = np.sqrt(np.maximum(sigma**2 - shared**2, 0.0))
        own[own < shared] = 0.0  # it is mainly the path that is poorly known
        end = int(np.argmax(own))
        count, length = int(walls.observations[row]), float(walls.high[row] - walls.low[row])
        name = f"Wall {walls.identity[row]} ({length:.1f} m)"
        if own[end] > MAX_WALL_SIGMA:
            text = (
                f"{name} is known to {_length(float(sigma[end]))} only at {_place(ends[row, end])}, and the path "
                f"beside it to {_length(float(path.sigma[beside[end]]))}"
            )
            drive = "Drive past this end, with the wall in view"
        elif count < MIN_OBSERVATIONS and length > MIN_LENGTH:
            text = f"{name} was observed by {count} keyframes only"
            drive = "Drive along it"
        else:
            continue
        stamp = float(path.stamps[beside[end]])
        places.append(WeakPlace(WeakKind.WALL, ends[row, end], ends[row], stamp, float(sigma[end]), None, text, drive))
        excess.append(float(own[end]))
    return [places[k] for k in np.argsort(-np.array(excess), kind="stable")]


def _place(point: Floats) -> str:
    return f"({point[0]:z.1f}, {point[1]:z.1f})"


def _length(metres: float) -> str:
    if metres >= 1.0:
        return f"{metres:.2f} m"
    return f"{1e2 * metres:.0f} cm" if metres >= 0.01 else f"{max(1e3 * metres, 1.0):.0f} mm"
