"""The changes between two maps, with a controlled share of false discoveries."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from drivers import se2

from ...geometry.segments import Floats, Integers
from ...mapping.map_features import MapWalls
from ...mapping.plan_walls import MIN_COMMON_LENGTH
from ...measuring.wall_map import WallGeometry
from ..wall_alignment import GATES, common_walls
from .end_shifts import EndShift, find_end_shifts
from .movement import Movements, find_movements
from .sight import SeenThrough, Sightings, covered_share, find_sightings
from .surveys import Survey, locate

# Metres across and radians by which a wall may have moved at most: farther apart, the old wall is gone and the new one
# is another wall. Origin: chosen; not measured.
MAX_SHIFT, MAX_TURN = 0.5, math.radians(10.0)
# Metres across and radians within which walls are the same until a test shows that one has moved.
# Origin: definition, the last gate of the alignment.
SAME_SHIFT, SAME_TURN = GATES[-1][0], math.radians(GATES[-1][1])
# Share of a stretch that a line covers if it bridges a door. Origin: chosen, most of it; not measured.
MIN_BRIDGED = 0.5
# Walls that are known not to have moved from which the motion between the maps follows. Origin: definition, three
# determine it.
MIN_UNMOVED = 3


class ChangeKind(StrEnum):
    """Kinds of changes.

    MOVED            in both maps, at significantly different places
    END_MOVED        an end of a wall, such as the jamb of a door, is at significantly different places along the wall
    GONE             scans of the new map have seen through it
    NEW              scans of the old map have seen through the place where it is now
    NOT_SEEN_AGAIN   in the old map only, but no scan of the new map shows that it is gone
    NOT_SEEN_BEFORE  in the new map only, but no scan of the old map shows that it was not there
    """

    MOVED = "moved"
    END_MOVED = "end moved"
    GONE = "gone"
    NEW = "new"
    NOT_SEEN_AGAIN = "not seen again"
    NOT_SEEN_BEFORE = "not seen before"


DIFFERENCES = (ChangeKind.MOVED, ChangeKind.END_MOVED, ChangeKind.GONE, ChangeKind.NEW)
"""Kinds that show a difference of the building; the others show one of the drives."""


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """A change of a wall.

    kind         what has changed
    old, new     identities of the wall in both maps; None in a map that does not have it
    stretches    (k, 2, 2) end points in the old map's frame: of the old wall, unless it is in the new map only; of an
                 end that has moved, its old and its new place
    p_value      probability of such evidence without a change; NaN without evidence
    shift, turn  of a moved wall: metres to the left of the old one, and radians; of an end that has moved: metres by
                 which the wall is longer, and NaN; else NaN
    sigma        (2,) standard deviations of both
    through      scans that have seen through it
    seen         scans that have seen it
    """

    kind: ChangeKind
    old: int | None
    new: int | None
    stretches: Floats
    p_value: float = math.nan
    shift: float = math.nan
    turn: float = math.nan
    sigma: tuple[float, float] = (math.nan, math.nan)
    through: int = 0
    seen: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class MapDiff:
    """Comparison of two maps.

    changes  moved, gone and new walls, most significant first; then those that only one of the drives has seen
    motion   (3,) pose of the new map in the old one
    same     number of walls that both maps contain, without those that have moved
    tests    number of tests
    scale    factor of all variances: 1, or more if the typical difference is larger than stated
    """

    changes: list[Change]
    motion: se2.Pose
    same: int
    tests: int
    scale: float

    @property
    def different(self) -> bool:
        """True if any wall has moved, is gone or is new."""
        return any(change.kind in DIFFERENCES for change in self.changes)


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
        pairs = _without_hidden(pairs, old.wall_map.walls, new.wall_map.walls, guess, old.hidden)
    known = np.isin(new.wall_map.walls.identity[pairs[:, 1]], list(unmoved))
    enough = known.sum() >= MIN_UNMOVED
    movements = find_movements(old.wall_map, new.wall_map, pairs, guess, known if enough else None)
    motion = movements.motion
    in_old = find_sightings(old, new, motion)
    in_new = find_sightings(new, old, se2.inverse(motion))
    if old.bridging:
        in_old = _without_bridged(in_old, old.wall_map, new.wall_map, motion)
    candidates = [
        *_moved(old.wall_map, new.wall_map, movements),
        *_ends_moved(old.wall_map, new.wall_map, find_end_shifts(old, new, movements) if old.scanned else []),
        *_seen_through(ChangeKind.GONE, old.wall_map, in_old, np.zeros(3)),
        *_seen_through(ChangeKind.NEW, new.wall_map, in_new, motion),
    ]
    without_stretch = sum(
        int((sightings.looked_at > 0.0).sum()) - len({stretch.wall for stretch in sightings.stretches})
        for sightings in (in_old, in_new)
    )
    p_values = np.array([change.p_value for change in candidates])
    tests = len(candidates) + without_stretch
    significant = benjamini_hochberg(p_values, tests, false_discovery_rate)
    found = sorted((candidates[k] for k in np.flatnonzero(significant)), key=lambda change: change.p_value)
    paired = movements.pairs
    unseen = [
        *_unseen(ChangeKind.NOT_SEEN_AGAIN, old.wall_map, in_old, paired[:, 0], found, np.zeros(3)),
        *_unseen(ChangeKind.NOT_SEEN_BEFORE, new.wall_map, in_new, paired[:, 1], found, motion),
    ]
    moved = sum(change.kind is ChangeKind.MOVED for change in found)
    return MapDiff([*found, *unseen], motion, len(paired) - moved, tests, movements.scale)


def _without_bridged(sightings: Sightings, old: WallGeometry, new: WallGeometry, motion: se2.Pose) -> Sightings:
    """Return the sightings without stretches that both maps cover with a line, as they do across doors."""
    gate = SAME_SHIFT, SAME_TURN
    kept = [one for one in sightings.stretches if covered_share(old, one, new, motion, gate) < MIN_BRIDGED]
    return replace(sightings, stretches=kept)


def find_pairs(old: MapWalls, new: MapWalls, motion: se2.Pose) -> Integers:
    """Return the rows (n, 2) of walls that are the same, or one of which may have been moved."""
    near = common_walls(old, new, motion, SAME_SHIFT, SAME_TURN)
    near = near[_shared_lengths(old, new, near, motion) >= MIN_COMMON_LENGTH]
    far = common_walls(old, new, motion, MAX_SHIFT, MAX_TURN)
    far = far[_shared_lengths(old, new, far, motion) >= MIN_COMMON_LENGTH]
    fresh = ~np.isin(far[:, 0], near[:, 0]) & ~np.isin(far[:, 1], near[:, 1])
    return np.concatenate([near, far[fresh]])


def _without_hidden(pairs: Integers, old: MapWalls, new: MapWalls, motion: se2.Pose, hidden: Floats) -> Integers:
    """Return the pairs (n, 2) without those whose new wall is nearer to a hidden line of the plan than to the old wall.

    hidden  (h, 2, 2) lines of the plan that no view shows, because of what is in front of them

    Such a new wall is the hidden line, seen because the old wall in front of it is gone: nothing has moved.
    """
    in_old, ends_of_old = se2.compose(motion, new.frame), old.end_points()
    kept = []
    for row, number in pairs.tolist():
        ends = np.asarray(se2.transform(se2.inverse(in_old[number]), np.concatenate([ends_of_old[[row]], hidden])))
        along = ends[:, 1] - ends[:, 0]
        low = np.maximum(ends[..., 0].min(axis=1), new.low[number])
        high = np.minimum(ends[..., 0].max(axis=1), new.high[number])
        turn = np.arctan2(along[:, 1], along[:, 0])
        offset = np.abs(ends[:, 0, 1] + (0.5 * (low + high) - ends[:, 0, 0]) * np.tan(turn))
        same = (high - low > MIN_COMMON_LENGTH) & (np.abs(turn) < SAME_TURN) & (offset < SAME_SHIFT)
        kept.append(not (same[1:] & (offset[1:] < offset[0])).any())
    return pairs[kept]


def _shared_lengths(old: MapWalls, new: MapWalls, pairs: Integers, motion: se2.Pose) -> Floats:
    """Return the metres (n,) along which pieces of both walls of a pair are next to each other."""
    frames = se2.compose(motion, new.frame).reshape(-1, 3)
    lengths = []
    for one, two in pairs.tolist():
        shift = float(se2.between(old.frame[one], frames[two])[0])
        low = np.maximum(old.pieces[one][:, None, 0], new.pieces[two][None, :, 0] + shift)
        high = np.minimum(old.pieces[one][:, None, 1], new.pieces[two][None, :, 1] + shift)
        lengths.append(float(np.maximum(high - low, 0.0).sum()))
    return np.array(lengths)


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
