"""Decision to close a loop, or to join parts of the map, at the place where a drive as a whole was located."""

from __future__ import annotations

from ..geometry.nearest_pose import relative_to_nearest
from ..geometry.segments import Integers
from ..loop_closure.criteria import confirm
from ..loop_closure.decision import Check, LoopDecision, LoopMatch
from ..loop_closure.look import Look
from ..loop_closure.loop_hypothesis import LoopHypothesis
from ..mapping.mapper import Mapper
from .location import Location, PlacedSubmap


def decide_at(
    look: Look, mapper: Mapper, location: Location, old: Integers, since: int, *, joins: bool
) -> LoopDecision:
    """Return the decision to move a drive to the place where it was located; it has no number yet.

    look   from the last keyframe
    old    (n,) keyframes of the map in which it was located
    since  first keyframe that is moved
    joins  true if it joins parts of the map
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
    last = member.keyframes[-1]
    row, relative = relative_to_nearest(mapper.keyframe_poses[old], member.pose)
    return LoopMatch(last, int(old[row]), relative, member.covariance, mapper.travelled[last], member.fit, member.known)
