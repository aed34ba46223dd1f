"""Search for the place of an unconnected part of the map in the other parts.

If odometry measured the way from the other part, the place is searched as in loop closure, within its uncertainty. A
robot that was carried may be anywhere, and trying all poses in the whole map takes too long: there the constellation of
the walls seen recently is searched in all walls. Looks along the way must agree with it, and distinguish it from every
pose that the walls match nearly as well. If the place is ambiguous, the part stays apart, and the search goes on as
the robot drives.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Integers
from ..localisation.local_field import LocalField
from ..mapping.mapper import Mapper
from ..matching.point_matcher import SEARCH_FIT
from .agreement import RIVAL_QUALITY, SEARCH_INTERVAL, LoopAgreement
from .criteria import MIN_KNOWN, SUPPORT_RATIO, confirm, differ, fits, is_determined, tell_apart
from .decision import Check, LoopDecision
from .look import Look, Submaps
from .loop_hypothesis import LoopAgreementState, LoopHypothesis
from .relocalisation import MapIndex, Relocalisation, index_map, relocalise, submap_of

# Keyframes and metres of driving between two searches by walls. Origin: chosen; not measured.
ATTEMPT_KEYFRAMES = 3
ATTEMPT_DISTANCE = 1.0  # Origin: as ATTEMPT_KEYFRAMES.
# Metres of driving whose walls are searched. Origin: chosen, some rooms; not measured.
RECENT_DISTANCE = 15.0
# Looks that must agree with the constellation of walls. Origin: definition, fewer cannot contradict each other.
MIN_LOOKS = 2


class JoinSearch:
    """Attempts to recognise the last part of the map in the others.

    agreements  searches for agreement, by the number of the group of parts that is searched; see `MapParts`
    """

    def __init__(self) -> None:
        self.agreements: dict[int, LoopAgreement] = {}
        self._last_keyframe, self._last_distance = -ATTEMPT_KEYFRAMES, -ATTEMPT_DISTANCE
        self._index: MapIndex | None = None  # of the other parts
        self._retracted: list[se2.Pose] = []

    def __deepcopy__(self, memo: dict[int, object]) -> JoinSearch:
        """Return an independent copy; the index is never changed and is shared."""
        other = JoinSearch()
        other.agreements = copy.deepcopy(self.agreements)
        other._last_keyframe, other._last_distance = self._last_keyframe, self._last_distance
        other._index = self._index
        other._retracted = list(self._retracted)
        return other

    def clear(self) -> None:
        """Discard all that was found: the map has been corrected."""
        self._index = None
        for agreement in self.agreements.values():
            agreement.clear()

    @property
    def states(self) -> dict[int, LoopAgreementState]:
        """States of the searches for agreement, to be saved."""
        return {group: agreement.state for group, agreement in self.agreements.items()}

    def restore(self, states: Mapping[int, LoopAgreementState], local_field: LocalField) -> None:
        """Continue from saved states; `local_field` has the points of all keyframes."""
        for group, state in states.items():
            self.agreements[group] = LoopAgreement(joins=True)
            self.agreements[group].restore(state, local_field)

    def exclude(self, motion: se2.Pose) -> None:
        """Reject the motion of a retracted join from now on."""
        self._retracted.append(motion)
        for agreement in self.agreements.values():
            agreement.exclude(motion)

    def search(self, mapper: Mapper, local_field: LocalField) -> LoopDecision | None:
        """Return the decision to join the last part of the map with another one, if it is recognised there."""
        parts, keyframes = mapper.landmarks.parts, np.arange(mapper.keyframe_count)
        connected, reachable = parts.connected(keyframes), parts.reachable(keyframes)
        groups = parts.groups_of(keyframes)
        for group in np.unique(groups[reachable & ~connected]).tolist():
            agreement = self.agreements.setdefault(group, LoopAgreement(joins=True))
            decision = agreement.search(mapper, local_field, groups == group)
            if decision is not None:
                return decision
        return None if reachable.all() else self._search_walls(mapper, local_field, connected, ~reachable)

    def _search_walls(
        self, mapper: Mapper, local_field: LocalField, connected: NDArray[np.bool_], apart: NDArray[np.bool_]
    ) -> LoopDecision | None:
        """Search the walls seen recently in those of the keyframes `apart` (k,), if a search is due."""
        travelled = np.asarray(mapper.travelled)
        keyframes, last, now = np.arange(len(connected)), mapper.keyframe_count - 1, float(travelled[-1])
        if last - self._last_keyframe < ATTEMPT_KEYFRAMES or now - self._last_distance < ATTEMPT_DISTANCE:
            return None
        self._last_keyframe, self._last_distance = last, now
        if self._index is None:
            self._index = index_map(mapper, apart)
        recent = connected & (travelled > now - RECENT_DISTANCE)
        found = relocalise(submap_of(mapper, recent), self._index)
        if found is None or not found.verdict.plausible:
            return None
        seen_by = mapper.landmarks.walls.rows["last_seen"][found.pairs[:, 0]]
        looks = _Looks(mapper, local_field, mapper.landmarks.parts.connected(keyframes, _most_frequent(seen_by)))
        if any(not differ(looks.at(last), found.motion, motion) for motion in self._retracted):
            return None
        return looks.decide(found, _spaced(np.flatnonzero(recent), travelled), int(connected.argmax()))


@dataclass(frozen=True, slots=True, eq=False)
class _Looks:
    """Looks from keyframes of the last part of the map at the places of the keyframes `apart` (k,) of another one."""

    mapper: Mapper
    local_field: LocalField
    apart: NDArray[np.bool_]
    submaps: Submaps = field(default_factory=Submaps)

    def at(self, keyframe: int) -> Look:
        """Return the look from a keyframe."""
        return Look(self.mapper, self.local_field, self.submaps, self.apart, apart=True, keyframe=keyframe)

    def decide(self, found: Relocalisation, keyframes: list[int], since: int) -> LoopDecision | None:
        """Return the decision to join where walls were found, if looks from some keyframes agree; None if not."""
        hypothesis, *rivals = self._judge([found.motion, *found.rivals], keyframes)
        count, against = len(hypothesis.support), len(hypothesis.contradictions)
        if not count:
            return None
        checks = (
            Check("support", count, MIN_LOOKS, at_least=True),
            Check("contradicted", against / count, 1.0 / SUPPORT_RATIO, at_least=False),
            Check("fit", hypothesis.mean_fit, SEARCH_FIT, at_least=True),
        )
        if not all(check.passed for check in checks) or not all(tell_apart(hypothesis, r) for r in rivals):
            return None
        return confirm(
            self.at(hypothesis.support[-1].keyframe),
            hypothesis,
            f"walls and {count} submap matches agree",
            rival_support=max((len(rival.support) for rival in rivals), default=0),
            contradictions=against,
            checks=checks,
            since=since,
            joins=True,
        )

    def _judge(self, motions: Sequence[se2.Pose], keyframes: list[int]) -> list[LoopHypothesis]:
        """Return a hypothesis for each motion in the map, supported or contradicted by looks from some keyframes."""
        hypotheses = [LoopHypothesis(motion) for motion in motions]
        for look in map(self.at, keyframes):
            tested = [(h, old, look.test(old, h.motion, look.last)) for h, old in self._places(look, hypotheses)]
            least = RIVAL_QUALITY * max((match.quality for _, _, match in tested if fits(match)), default=0.0)
            for hypothesis, old, match in tested:
                moved = differ(look, look.motion(old, match.pose), hypothesis.motion)
                if moved or not fits(match) or match.quality < least:
                    hypothesis.contradictions += [look.travelled] if match.known >= MIN_KNOWN else []
                elif is_determined(match):
                    hypothesis.support.append(look.loop_match(old, match))
        return hypotheses

    @staticmethod
    def _places(look: Look, hypotheses: Sequence[LoopHypothesis]) -> list[tuple[LoopHypothesis, int]]:
        """Return the hypotheses that have the robot at an old place, with its keyframe."""
        places = [(h, look.place_at(se2.compose(h.motion, look.pose))) for h in hypotheses]
        return [(hypothesis, old) for hypothesis, old in places if old is not None]


def _most_frequent(keyframes: Integers) -> int:
    """Return the keyframe that occurs most often among some (n,)."""
    return int(np.bincount(keyframes).argmax())


def _spaced(keyframes: NDArray[np.int64], travelled: NDArray[np.float64]) -> list[int]:
    """Return the first, the last, and those of some keyframes in between that are SEARCH_INTERVAL metres apart."""
    chosen = [int(keyframes[-1])]
    for keyframe in keyframes[::-1].tolist():
        if travelled[chosen[-1]] - travelled[keyframe] >= SEARCH_INTERVAL:
            chosen.append(keyframe)
    return sorted({int(keyframes[0]), *chosen})
