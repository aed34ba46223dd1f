"""Changes of walls between two maps, as data."""

from __future__ import annotations

import math
from enum import StrEnum

from drivers import se2
from drivers.immutable import immutable

from ...geometry.segments import Floats


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


@immutable
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


@immutable
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
