"""Match of two places of a map that a person states to be one."""

from __future__ import annotations

import numpy as np

from drivers import se2

from ...errors import MapError
from ...estimation.slam_state import SlamState
from ...formatting import percent, percent_apart
from ...localisation.local_field import REFERENCE_DISTANCE
from ...loop_closure.criteria import MIN_KNOWN, MIN_LOOP_FIT, is_determined
from ...loop_closure.look import Look
from ...loop_closure.submap_search import REVISIT_GAP, SubmapMatch, search_submap
from ...loop_closure.submaps import Submaps
from ...loop_closure.votes import RIVAL_QUALITY

MIN_PLACE_FIT = 0.75
"""Least fit of a match, more than at a loop closure: no other look has to agree, and no evidence is required. Where a
closure was proposed, or closed before, looks or the evidence have led there, so MIN_LOOP_FIT is enough."""
PROPOSED_REACH = 1.0
"""Metres around the pose of a proposed closure that are searched first: keyframes have moved since it was proposed."""
PROPOSED_TURN = 0.2
"""Radians, likewise."""


def match_places(state: SlamState, old: int, keyframe: int, motion: se2.Pose | None) -> tuple[Look, SubmapMatch]:
    """Match the scans up to a keyframe with those around an old one.

    motion  [x, y, heading] by which the robot would have moved in its own frame if the closure was proposed; None if
            not. If the scans do not fit there, as the map has been corrected since, or without a proposal, all poses
            within REFERENCE_DISTANCE of the old keyframe are searched, with any heading

    The keyframes may be in parts of the map that are not connected. Returns the look at the old place, and the match.
    Raises MapError if the places are of one pass, or if the scans do not fit, or fit at several poses of which the
    estimate's uncertainty admits none or several.
    """
    name, mapper = f"keyframes {old} and {keyframe}", state.mapper
    apart = mapper.landmarks.parts.group(old) != mapper.landmarks.parts.group(keyframe)
    driven = mapper.travelled[keyframe] - mapper.travelled[old]
    if driven <= REVISIT_GAP and not apart:
        raise MapError(f"{name}: only {driven:.1f} m of driving apart (more than {REVISIT_GAP:.0f} m needed)")
    among = mapper.landmarks.parts.connected(np.arange(mapper.keyframe_count), old)
    look = Look(mapper, state.local_field, Submaps(), among, apart=apart, keyframe=keyframe)
    here = look.relative(old, np.zeros(3))
    searches = [(np.array([0.0, 0.0, here[2]]), REFERENCE_DISTANCE, np.pi, MIN_PLACE_FIT)]
    if motion is not None:
        searches.insert(0, (se2.compose(here, motion), PROPOSED_REACH, PROPOSED_TURN, MIN_LOOP_FIT))
    matches = list[SubmapMatch]()
    for prediction, reach, turn, least in searches:
        if not matches:
            found = search_submap(look.submap, look.old_submap(old), prediction, reach, turn)
            matches = [m for m in found if m.known >= MIN_KNOWN and m.fit >= least and is_determined(m)]
    if not matches:
        raise MapError(f"{name} are not one place: {_misfit(found)}")
    rivals = [match for match in matches if match.quality >= RIVAL_QUALITY * matches[0].quality]
    if len(rivals) > 1:
        admitted = [match for match in rivals if look.admits(old, match.pose)]
        if len(admitted) != 1:
            raise MapError(f"{name}: the scans fit at {len(rivals)} poses equally well; name other keyframes nearby")
        rivals = admitted
    return look, rivals[0]


def _misfit(found: list[SubmapMatch]) -> str:
    """Return why no match counts, in words; they are sorted by their scores."""
    if not found:
        return "the scans fit at no pose"
    fitting = [match for match in found if match.fit >= MIN_PLACE_FIT]
    if not fitting:
        fit, needed = percent_apart(found[0].fit, MIN_PLACE_FIT), percent(MIN_PLACE_FIT)
        return f"at the best pose {fit} of the points fit (at least {needed} needed)"
    known = max(match.known for match in fitting)
    if known < MIN_KNOWN:  # where nothing was seen, nothing contradicts
        seen = f"{percent_apart(known, MIN_KNOWN)} of what the later ones show (at least {percent(MIN_KNOWN)} needed)"
        return f"the scans fit only where the older ones have seen {seen}"
    return "the scans do not determine the position in every direction, as along a bare corridor"
