"""Comparison of two maps: the changes of walls, with a controlled share of false discoveries."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from drivers import se2

from ...geometry.segments import Floats, Integers
from ...mapping.map_features import MapWalls
from ...measuring.wall_map import WallGeometry
from .changes import Change, ChangeKind, MapDiff
from .end_shifts import EndShift, find_end_shifts
from .movement import Movements, find_movements
from .sight import SeenThrough, Sightings, covered_share, find_sightings
from .surveys import Survey, locate
from .wall_pairs import SAME_SHIFT, SAME_TURN, find_pairs, without_hidden

# Share of a stretch that a line covers if it bridges a door. Origin: chosen, most of it; not measured.
MIN_BRIDGED = 0.5
# Walls that are known not to have moved from which the motion between the maps follows. Origin: definition, three
# determine it.
MIN_UNMOVED = 3


def compare(old: Survey, new: Survey, false_discovery_rate: float, guess: se2.Pose | None = None) -> MapDiff:
    """Compare two maps of one building.

    false_discovery_rate  expected share of false ones among the changes that are reported as significant, by the
                          procedure of Benjamini and Hochberg (1995) over the tests of all walls
    guess                 rough pose of the new map in the old one; if None, the new map is searched for in the old one

    Raises MapError if the maps cannot be aligned.
    """
    return find_changes(old, new, locate(old, new, guess), false_discovery_rate)


def find_changes(
    old: Survey, new: Survey, guess: se2.Pose, false_discovery_rate: float, unmoved: Collection[int] = ()
) -> MapDiff:
    """Compare two maps as `compare` does, given a guess of the pose of the new map in the old one.

    unmoved  identities in the new map of walls that are known not to have moved, if any are known
    """
    pairs = find_pairs(old.wall_map.walls, new.wall_map.walls, guess)
    if old.hidden is not None:
        pairs = without_hidden(pairs, old.wall_map.walls, new.wall_map.walls, guess, old.hidden)
    known = np.isin(new.wall_map.walls.identity[pairs[:, 1]], list(unmoved))
    enough = known.sum() >= MIN_UNMOVED
    movements = find_movements(old.wall_map, new.wall_map, pairs, guess, known if enough else None)
    motion, paired = movements.motion, movements.pairs
    in_old, in_new = find_sightings(old, new, motion), find_sightings(new, old, se2.inverse(motion))
    if old.bridging:
        in_old = _without_bridged(in_old, old.wall_map, new.wall_map, motion)
    candidates = _candidates(old, new, movements, in_old, in_new)
    tests = len(candidates) + in_old.walls_not_seen_through + in_new.walls_not_seen_through
    p_values = np.array([change.p_value for change in candidates])
    significant = benjamini_hochberg(p_values, tests, false_discovery_rate)
    found = sorted((candidates[k] for k in np.flatnonzero(significant)), key=lambda change: change.p_value)
    unseen = [
        *_unseen(ChangeKind.NOT_SEEN_AGAIN, old.wall_map, in_old, paired[:, 0], found, np.zeros(3)),
        *_unseen(ChangeKind.NOT_SEEN_BEFORE, new.wall_map, in_new, paired[:, 1], found, motion),
    ]
    moved = sum(change.kind is ChangeKind.MOVED for change in found)
    return MapDiff([*found, *unseen], motion, len(paired) - moved, tests, movements.scale)


def _candidates(old: Survey, new: Survey, movements: Movements, in_old: Sightings, in_new: Sightings) -> list[Change]:
    """Return all changes for which there is evidence, significant or not."""
    return [
        *_moved(old.wall_map, new.wall_map, movements),
        *_ends_moved(old.wall_map, new.wall_map, find_end_shifts(old, new, movements) if old.scanned else []),
        *_seen_through(ChangeKind.GONE, old.wall_map, in_old, np.zeros(3)),
        *_seen_through(ChangeKind.NEW, new.wall_map, in_new, movements.motion),
    ]


def _without_bridged(sightings: Sightings, old: WallGeometry, new: WallGeometry, motion: se2.Pose) -> Sightings:
    """Return the sightings without stretches that both maps cover with a line, as they do across doors."""
    gate = SAME_SHIFT, SAME_TURN
    kept = [one for one in sightings.stretches if covered_share(old, one, new, motion, gate) < MIN_BRIDGED]
    return replace(sightings, stretches=kept)


def benjamini_hochberg(p_values: Floats, tests: int, rate: float) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return (n,) which of some p-values are significant among so many tests; those not given are 1.

    With the p-values in ascending order, those up to the largest k with p_k <= k / tests * rate (Benjamini and Hochberg
    1995).
    """
    order = np.argsort(p_values, kind="stable")
    below = np.flatnonzero(p_values[order] <= np.arange(1, len(order) + 1) / max(tests, 1) * rate)
    significant = np.zeros(len(p_values), dtype=bool)
    significant[order[: below[-1] + 1 if len(below) else 0]] = True
    return significant


def _moved(old: WallGeometry, new: WallGeometry, movements: Movements) -> list[Change]:
    """Return a candidate for each wall of both maps."""
    ends = [_stretches(old.walls, row, np.zeros(3)) for row in movements.pairs[:, 0].tolist()]
    return [
        Change(
            ChangeKind.MOVED,
            int(old.walls.identity[one]),
            int(new.walls.identity[two]),
            ends[k],
            float(movements.p_value[k]),
            float(movements.shift[k]),
            float(movements.turn[k]),
            (float(movements.sigma[k, 0]), float(movements.sigma[k, 1])),
        )
        for k, (one, two) in enumerate(movements.pairs.tolist())
    ]


def _ends_moved(old: WallGeometry, new: WallGeometry, shifts: list[EndShift]) -> list[Change]:
    """Return a candidate for each end of a wall that both maps have."""
    return [
        Change(
            ChangeKind.END_MOVED,
            int(old.walls.identity[shift.walls[0]]),
            int(new.walls.identity[shift.walls[1]]),
            np.array([[old.point(shift.walls[0], along) for along in shift.span]]),
            shift.p_value,
            shift.longer,
            sigma=(shift.sigma, math.nan),
            through=shift.through,
            seen=shift.seen,
        )
        for shift in shifts
    ]


def _seen_through(kind: ChangeKind, wall_map: WallGeometry, sightings: Sightings, motion: se2.Pose) -> list[Change]:
    """Return a candidate for each stretch that was seen through; `motion` leads from its map to the old one."""
    return [_candidate(kind, wall_map, stretch, motion) for stretch in sightings.stretches]


def _candidate(kind: ChangeKind, wall_map: WallGeometry, stretch: SeenThrough, motion: se2.Pose) -> Change:
    identity = int(wall_map.walls.identity[stretch.wall])
    ends = np.array([[wall_map.point(stretch.wall, along) for along in stretch.span]])
    gone = kind is ChangeKind.GONE
    return Change(
        kind,
        identity if gone else None,
        None if gone else identity,
        np.asarray(se2.transform(motion, ends)),
        stretch.p_value,
        through=stretch.through,
        seen=stretch.seen,
    )


def _unseen(
    kind: ChangeKind,
    wall_map: WallGeometry,
    sightings: Sightings,
    paired: Integers,
    found: list[Change],
    motion: se2.Pose,
) -> list[Change]:
    """Return the walls of one map that the other map lacks and of which its scans have seen less than half."""
    walls = wall_map.walls
    lengths = np.array([float((pieces[:, 1] - pieces[:, 0]).sum()) for pieces in walls.pieces])
    again = kind is ChangeKind.NOT_SEEN_AGAIN
    named = {change.old if again else change.new for change in found}
    rows = np.setdiff1d(np.flatnonzero(sightings.seen < 0.5 * lengths), paired)
    result = []
    for row in rows.tolist():
        identity = int(walls.identity[row])
        if identity not in named:
            ends = _stretches(walls, row, motion)
            result.append(Change(kind, identity if again else None, None if again else identity, ends))
    return result


def _stretches(walls: MapWalls, row: int, motion: se2.Pose) -> Floats:
    """Return the end points (k, 2, 2) of the pieces of a wall, in the old map's frame."""
    return np.asarray(se2.transform(motion, walls.piece_points_of(row)))
