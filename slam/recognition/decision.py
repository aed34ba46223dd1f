"""Decision to move the last part of a drive to the place at which its submaps were recognised."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Integers
from ..localisation.local_field import LocalField
from ..loop_closure.criteria import confirm
from ..loop_closure.decision import Check, LoopDecision, LoopMatch
from ..loop_closure.look import Look
from ..loop_closure.loop_hypothesis import LoopHypothesis
from ..mapping.mapper import Mapper
from .location import Location, PlacedSubmap
from .map_index import index_map
from .scanned_map import ScannedMap, scan_map


def scan_keyframes(mapper: Mapper, local_field: LocalField, chosen: NDArray[np.bool_]) -> ScannedMap:
    """Prepare the map of the keyframes `chosen` (k,) to search in."""
    rows = np.flatnonzero(chosen)
    return scan_map(index_map(mapper, chosen), mapper.keyframe_poses[rows], local_field.points_of(rows))


def decide(look: Look, mapper: Mapper, location: Location, old: Integers, *, since: int, joins: bool) -> LoopDecision:
    """Return the decision to move the drive where it was located.

    look   from the last keyframe
    old    (n,) keyframes of the map in which it was located
    since  first keyframe that is moved
    joins  true if both are in parts of the map that are not connected
    """
    matches = [_match(mapper, member, old) for member in location.members]
    count = len(matches)
    return confirm(
        look,
        LoopHypothesis(location.members[-1].motion, matches),
        f"{count} of {location.submaps} submaps fit in one place only",
        rival_support=0,
        contradictions=location.submaps - count,
        checks=(Check("evidence", location.evidence, location.required, at_least=True),),
        since=since,
        joins=joins,
    )


def _match(mapper: Mapper, member: PlacedSubmap, old: Integers) -> LoopMatch:
    """Return the match of a submap with the nearest of the keyframes `old` (n,)."""
    last, poses = member.keyframes[-1], mapper.keyframe_poses
    nearest = int(old[np.hypot(*(poses[old, :2] - member.pose[:2]).T).argmin()])
    relative = se2.between(poses[nearest], member.pose)
    return LoopMatch(last, nearest, relative, member.covariance, mapper.travelled[last], member.fit, member.known)
