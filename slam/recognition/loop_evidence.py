"""Loop closure by evidence: the drive through a known place must fit there, as a whole, better than elsewhere.

Looks at old places find loops and agree on them (see `loop_closure.agreement`). A look compares shares of points, so a
bare corridor fits along all of its length. Therefore the drive since the first look that supports a loop is searched as
a whole where it may be by the uncertainty of the estimate, and the evidence of all its submaps must suffice for the
place that the looks agree on; see `location`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats, Integers
from ..localisation.local_field import LocalField
from ..loop_closure.criteria import MIN_SUPPORT, admits_closure, differ
from ..loop_closure.decision import LoopDecision, LoopMatch
from ..loop_closure.look import Look
from ..loop_closure.loop_status import LoopStatus
from ..loop_closure.submap_search import SUBMAP_LENGTH, are_distinct
from ..loop_closure.submaps import Submaps
from ..mapping.mapper import Mapper
from ..matching.distance_field import FIELD_HALF_WIDTH
from .drive_scans import DriveScans
from .located_closure import decide_at
from .location import DOUBTED, RECOGNISED, RETURNED, Expectation, Location, PlacedSubmap, locate
from .placements import Uncertainty
from .scanned_map import scan_keyframes
from .self_similarity import SelfSimilarity


def check_evidence(
    mapper: Mapper, local_field: LocalField, decision: LoopDecision, among: NDArray[np.bool_]
) -> LoopDecision:
    """Return a loop that looks agree on, with only those matches that lead to where the drive as a whole fits.

    It is rejected if the evidence of the drive does not suffice for any place. If it suffices for a place where few
    matches are, the loop is closed there: looks follow furniture that was moved, of which they show much. There, and if
    a check of the decision has failed, the evidence must also outweigh how much places of the map look alike.

    among  (k,) keyframes of the connected part of the map
    """
    place, poses = decision.matches[-1].old, mapper.keyframe_poses
    look = Look(mapper, local_field, Submaps(), among, doubted=decision.doubted)
    first = look.keyframe_at(decision.matches[0].travelled - SUBMAP_LENGTH)
    reach = _distances(poses[first:], poses[first]).max() + look.uncertainty.search_radius(place) + FIELD_HALF_WIDTH
    travelled = np.asarray(mapper.travelled)
    old = among & (travelled < travelled[first] - SUBMAP_LENGTH) & (_distances(poses, look.pose) < reach)
    places = [match.old for match in decision.matches]
    old &= local_field.path_distances(mapper.travelled).are_nearer(places, [first])
    if not old.any():
        return replace(
            decision, status=LoopStatus.REJECTED, reason="all keyframes near the old place belong to the drive"
        )
    drive, known = DriveScans().take(mapper, local_field, first), scan_keyframes(mapper, local_field, old)
    uncertainty = Uncertainty(look.uncertainty.covariance(place))
    search = partial(locate, drive, known, _expected(look, decision), uncertainty)
    similarity = SelfSimilarity(mapper, local_field, old, known).of
    passed = tuple(check for check in decision.checks if check.passed)
    has_passed = passed == decision.checks
    location = search(None if has_passed else similarity)
    there = _matches_at(location.members, look, decision.matches, poses)
    elsewhere = f"{len(decision.matches) - len(there)} of {len(decision.matches)} looks"
    if len(there) >= MIN_SUPPORT and there[-1] is decision.matches[-1]:
        suffix = "" if len(there) == len(decision.matches) else f", but {elsewhere} are at another place than the drive"
        return replace(decision, matches=there, reason=decision.reason + suffix, checks=passed)
    if location.accepted:
        unique = search(similarity) if has_passed else location
        if (closure := _closure_elsewhere(look, mapper, unique, np.flatnonzero(old), decision)) is not None:
            return closure
    where = f"fits at another place than {elsewhere}" if location.accepted else "does not fit there"
    reason = f"the drive as a whole {where}: {location.reason}"
    return replace(decision, status=LoopStatus.REJECTED, reason=reason)


def _closure_elsewhere(
    look: Look, mapper: Mapper, location: Location, old: Integers, decision: LoopDecision
) -> LoopDecision | None:
    """Return the decision to close a loop where the drive was located, if it was, and has to be moved for it.

    old       (n,) keyframes of the map in which it was located
    decision  that looks agree on, to close the loop at another place
    """
    if not location.accepted or location.evidence < RECOGNISED.required:
        return None
    closure = decide_at(look, mapper, location, old, decision.since, joins=False)
    last = closure.matches[-1]
    if not differ(look, closure.correction, np.zeros(3)) or not admits_closure(look, last.old, last.relative):
        return None
    reason = f"{closure.reason}, at another place than the looks that agree"
    return replace(closure, candidate=decision.candidate, reason=reason)


def _matches_at(
    members: Sequence[PlacedSubmap], look: Look, matches: Sequence[LoopMatch], poses: Floats
) -> tuple[LoopMatch, ...]:
    """Return the matches that move their keyframes to the place where the drive as a whole was placed.

    members  submaps of the drive that are certain of their place: the one nearest to a keyframe counts there
    poses    (k, 3) of the keyframes
    """
    there = []
    for match in matches if members else ():
        nearest = min(members, key=lambda member: abs(member.keyframes[-1] - match.keyframe))
        moved = (se2.compose(motion, poses[match.keyframe]) for motion in (nearest.motion, look.motion_of(match)))
        if not are_distinct(*moved):
            there.append(match)
    return tuple(there)


def _expected(look: Look, decision: LoopDecision) -> Expectation:
    """Return what is known before about where the drive is."""
    if decision.doubted:
        return DOUBTED
    return RECOGNISED if differ(look, decision.correction, np.zeros(3)) else RETURNED


def _distances(poses: Floats, pose: se2.Pose) -> Floats:
    """Return the distances (k,) of poses (k, 3) from another one, metres."""
    return np.asarray(np.hypot(*(poses[:, :2] - pose[:2]).T))
