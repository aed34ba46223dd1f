"""Separation of a pass from earlier ones: what it observed again of their landmarks becomes landmarks of its own.

The features of a pass that was mapped at a wrong pose, because of drift or of a wrong loop closure, are associated with
landmarks of earlier passes that may be others. These observations, walls merged with older ones, and matches with old
keyframes hold the pass where it is. Once it is separated, a loop can be closed or opened.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Segments
from ..graph.factors import MATCH_KINDS, Factor, FactorKind
from ..graph.rebuilding import LandmarkCopy, with_copies
from .keyframes import LandmarkIds
from .read_back import recompute_covariances
from .repeated_observation import drop_unobserved, forget_observations

if TYPE_CHECKING:
    from .mapper import Mapper

Seen = Mapping[int, frozenset[int]]
"""Keyframes that observe a landmark, by landmark."""


@dataclass(frozen=True, slots=True)
class Pass:
    """Consecutive keyframes that drive through places of earlier ones.

    gap  metres of driving since the last observation of a landmark from which on the next one is made on a return; zero
         if each observation of an earlier landmark in the pass is made on a return
    """

    keyframes: range
    gap: float


def separate_pass(
    mapper: Mapper,
    new_pass: Pass,
    segments: Sequence[Segments],
    *,
    ties: Collection[tuple[int, int]] = (),
    merged: Collection[tuple[int, int]] = (),
    remove: Callable[[Factor], bool] = lambda _: False,
    add: Sequence[Factor] = (),
) -> NDArray[np.bool_]:
    """Separate a pass from the keyframes before it, and solve the graph again.

    segments     of each keyframe
    ties         walls (kept, absorbed) that stay one although they are of both
    merged       walls (kept, absorbed) that were merged since the pass was mapped at a wrong pose: from a distance,
                 keyframes just before the pass have seen the same place. They are separated if they are of neither, and
                 were observed with a gap between them
    remove, add  other factors that are removed and added

    Older walls that scans of the pass have seen through are there again, as the scans were elsewhere. The graph has
    been solved with all keyframes. Returns (w,) which walls are of the pass alone. Raises MapError if a variable is
    left undetermined.
    """
    landmarks, division = mapper.landmarks, _Division(mapper, new_pass)
    factors = mapper.graph.solver.sorted_factors()
    equalities = [factor for factor in factors if factor.kind is FactorKind.WALL_EQUALITY]
    kept, copied = division.equalities(equalities, set(ties), set(merged))
    pairs = {(factor.first, factor.second) for factor in kept}
    start = new_pass.keyframes.start
    gap_begins = mapper.travelled[start] - new_pass.gap
    before = min(int(np.searchsorted(mapper.travelled, gap_begins, side="right")), start) - 1

    def is_removed(factor: Factor) -> bool:
        if factor.kind is FactorKind.WALL_EQUALITY:
            return (factor.first, factor.second) not in pairs
        across = factor.kind in MATCH_KINDS and factor.first <= before and factor.second in new_pass.keyframes
        return across or remove(factor)

    _add_copies(mapper, division)
    mapper.graph = with_copies(mapper.graph, division.walls, division.corners, is_removed, [*copied, *add])
    mapper.graph.update_until_converged()
    mapper.landmark_ids = _with_copies(mapper.landmark_ids, division)
    mapper.read_back_all()
    restored = landmarks.restore_walls(division.older_walls, new_pass.keyframes)
    walls = division.concerned(restored)
    _observe_again(mapper, walls, [*kept, *copied], segments)
    shown = walls[landmarks.walls.rows["merged_into"][walls] == walls]
    recompute_covariances(landmarks, mapper.graph, shown.tolist(), [one.copy for one in division.corners])
    first_seen = landmarks.walls.rows["first_seen"]
    return np.asarray((first_seen >= new_pass.keyframes.start) & (first_seen < new_pass.keyframes.stop))


class _Division:
    """Division of a map's landmarks between a pass and the other keyframes.

    walls, corners  copies of those that the pass observes again and others observe, too
    older_walls     observed walls that are not of the pass alone
    """

    def __init__(self, mapper: Mapper, new_pass: Pass) -> None:
        self._keyframes, self._gap = new_pass.keyframes, new_pass.gap
        self._groups = dict(enumerate(mapper.landmarks.walls.rows["merged_into"].tolist()))
        self._seen = _observers(mapper, FactorKind.WALL_HEADING)
        together: dict[int, frozenset[int]] = {}  # by the walls into which they were merged
        for wall, seen in self._seen.items():
            together[self._groups[wall]] = together.get(self._groups[wall], frozenset()) | seen
        self._first = {root: min(seen) for root, seen in together.items()}
        self._travelled = travelled = np.asarray(mapper.travelled)
        self._again = {root: _seen_again(seen, new_pass, travelled) for root, seen in together.items()}
        again = {wall: seen & self._again[self._groups[wall]] for wall, seen in self._seen.items()}
        self.walls = _copies(self._seen, again, len(mapper.landmarks.walls))
        corners = _observers(mapper, FactorKind.CORNER)
        again = {corner: _seen_again(seen, new_pass, travelled) for corner, seen in corners.items()}
        self.corners = _copies(corners, again, len(mapper.landmarks.corners))
        self.older_walls = [wall for wall in self._seen if not self._is_of_pass(wall)]
        self._unmerged = set[int]()  # walls of which others are separated that were merged into them
        self._copy = {one.original: one.copy for one in self.walls}

    def _is_of_pass(self, wall: int) -> bool:
        """Return True if an original wall is observed, and is of the pass alone."""
        root = self._groups[wall]
        return wall in self._seen and (self._first[root] in self._keyframes or self._seen[wall] <= self._again[root])

    def _are_apart(self, first: int, second: int) -> bool:
        """Return True if the keyframes before the pass have observed two walls with a gap between them."""
        one, other = (
            self._travelled[[keyframe for keyframe in self._seen.get(wall, ()) if keyframe < self._keyframes.start]]
            for wall in (first, second)
        )
        return bool(len(one) and len(other) and np.abs(one[:, None] - other[None]).min() > self._gap)

    def of_pass(self, wall: int) -> int | None:
        """Return the copy of a wall, or the wall itself if it is of the pass alone; None if it is not of the pass."""
        return self._copy.get(wall, wall if self._is_of_pass(wall) else None)

    def equalities(
        self, factors: Iterable[Factor], ties: Set[tuple[int, int]], merged: Set[tuple[int, int]]
    ) -> tuple[list[Factor], list[Factor]]:
        """Return the equalities of walls that stay, and new ones of copies; those between two passes are left out."""
        kept, copied = [], []
        for factor in factors:
            first, second = factor.first, factor.second
            across = self._is_of_pass(first) != self._is_of_pass(second)
            if (first, second) in merged and self._are_apart(first, second):
                across = True
                self._unmerged.add(self._groups[first])
            if (first, second) in ties or not across:
                kept.append(factor)
            one, other = self.of_pass(first), self.of_pass(second)
            if one is not None and other is not None and (one, other) != (first, second):
                copied.append(Factor(factor.kind, one, other, factor.measured, factor.covariance))
        return kept, copied

    def concerned(self, restored: Iterable[int]) -> NDArray[np.int64]:
        """Return the walls whose observations have changed, with all merged with them, and those `restored`."""
        roots = {root for root, again in self._again.items() if again} | self._unmerged
        roots |= {self._groups[wall] for wall in restored}
        walls = [wall for wall, root in self._groups.items() if root in roots]
        return np.array([*walls, *self._copy.values()], dtype=np.int64)


def _observers(mapper: Mapper, kind: FactorKind) -> Seen:
    """Return the keyframes that observe each landmark, by the factors of a kind."""
    result: dict[int, set[int]] = {}
    for factor in mapper.graph.solver.sorted_factors():
        if factor.kind is kind:
            result.setdefault(factor.second, set()).add(factor.first)
    return {landmark: frozenset(seen) for landmark, seen in result.items()}


def _seen_again(seen: frozenset[int], new_pass: Pass, travelled: NDArray[np.float64]) -> frozenset[int]:
    """Return the keyframes of a pass that observe a landmark again, of all that have `seen` it; see `Pass.gap`."""
    keyframes = np.sort(list(seen))
    if keyframes[0] >= new_pass.keyframes.start:
        return frozenset()
    again = np.concatenate([[False], np.cumsum(np.diff(travelled[keyframes]) >= new_pass.gap) > 0])
    return frozenset(keyframes[again].tolist()) & frozenset(new_pass.keyframes)


def _copies(seen: Seen, again: Seen, first: int) -> list[LandmarkCopy]:
    """Return copies, numbered from `first`, of the landmarks that some keyframes observe again, and others, too."""
    divided = [landmark for landmark in seen if again[landmark] and again[landmark] != seen[landmark]]
    return [LandmarkCopy(landmark, first + k, again[landmark]) for k, landmark in enumerate(divided)]


def _add_copies(mapper: Mapper, division: _Division) -> None:
    """Add the copies to the landmarks of a map."""
    landmarks = mapper.landmarks
    for wall in division.walls:
        new = landmarks.add_wall(landmarks.walls.rows["frame"][wall.original], 0.0, min(wall.keyframes))
        landmarks.walls.rows["in_graph"][new] = True
    seen = _observers(mapper, FactorKind.CORNER)
    for corner in division.corners:
        sides = landmarks.corners.rows["walls"][corner.original].tolist()
        of_pass = [-1 if wall < 0 else division.of_pass(wall) for wall in sides]
        walls = np.array([side if wall is None else wall for side, wall in zip(sides, of_pass, strict=True)])
        row = landmarks.corners.rows[corner.original]
        new = landmarks.add_corner(row["position"], row["headings"], walls, max(corner.keyframes))
        for each, keyframes in ((new, corner.keyframes), (corner.original, seen[corner.original] - corner.keyframes)):
            row = landmarks.corners.rows[each]
            row["in_graph"], row["observations"], row["last_seen"] = True, len(keyframes), max(keyframes)


def _with_copies(landmark_ids: Sequence[LandmarkIds], division: _Division) -> list[LandmarkIds]:
    """Return the landmark ids of all keyframes with the copies."""
    result = list(landmark_ids)
    for copies, name in ((division.walls, "walls"), (division.corners, "corners")):
        for one in copies:
            for keyframe in one.keyframes:
                ids = {"walls": result[keyframe].walls, "corners": result[keyframe].corners}
                result[keyframe] = LandmarkIds(**ids | {name: np.where(ids[name] == one.original, one.copy, ids[name])})
    return result


def _observe_again(
    mapper: Mapper, walls: NDArray[np.int64], equalities: Iterable[Factor], segments: Sequence[Segments]
) -> None:
    """Merge some walls (n,) by equalities, and recompute what depends on their observations by all keyframes."""
    landmarks, rows = mapper.landmarks, mapper.landmarks.walls.rows
    forget_observations(landmarks, walls)
    merged_into = {wall: wall for wall in walls.tolist()}
    for factor in equalities:
        if factor.first in merged_into:
            kept, absorbed = merged_into[factor.first], merged_into[factor.second]
            merged_into |= {wall: kept for wall, root in merged_into.items() if root == absorbed}
    rows["merged_into"][list(merged_into)] = list(merged_into.values())
    observed = set(mapper.graph.wall_observations())  # without those that closures have removed
    for keyframe, ids in enumerate(mapper.landmark_ids):
        frames = se2.compose(mapper.keyframe_poses[keyframe], segments[keyframe].frame).reshape(-1, 3)
        for i in np.flatnonzero(np.isin(ids.walls, walls)).tolist():
            wall, half_length = int(ids.walls[i]), float(segments[keyframe].half_length[i])
            if (keyframe, wall) in observed:
                landmarks.observe_wall(int(rows["merged_into"][wall]), frames[i], half_length, keyframe)
    drop_unobserved(landmarks)
    mapper.free_space_evidence.discard(walls.tolist())
