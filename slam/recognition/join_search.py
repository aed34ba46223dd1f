"""Search for the place of an unconnected part of the map in the other parts.

If odometry measured the way from the other part, the place is searched as in loop closure, within its uncertainty. A
robot that was carried may be anywhere: there, all submaps since then are searched together in the whole map, and the
evidence of all of them decides; see `location`. So it is if looks contradict what odometry measured: the robot lost its
pose on the way, and the wheels may have failed there too. If the place is ambiguous, the part stays apart, and the
search goes on as the robot drives.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Integers
from ..localisation.local_field import LocalField
from ..loop_closure.agreement import LoopAgreement
from ..loop_closure.criteria import differ
from ..loop_closure.decision import LoopDecision
from ..loop_closure.look import Look
from ..loop_closure.loop_hypothesis import LoopAgreementState
from ..loop_closure.submaps import Submaps
from ..mapping.mapper import Mapper
from .drive_scans import DriveScans
from .located_closure import decide_at
from .location import LOST, Expectation, Location, locate
from .scanned_map import ScannedMap, scan_keyframes
from .self_similarity import SelfSimilarity


class JoinSearch:
    """Attempts to recognise the last part of the map in the others.

    expected    what is known before about the place of the last part
    agreements  searches for agreement, by the number of the group of parts that is searched; see `MapParts`
    """

    def __init__(self, expected: Expectation = LOST) -> None:
        self.expected = expected
        self.agreements: dict[int, LoopAgreement] = {}
        self._drive = DriveScans()
        self._maps: dict[int, ScannedMap] = {}  # of other parts, by the number of their group
        self._similarities: dict[int, dict[int, float]] = {}  # of these maps, see `SelfSimilarity`
        self._retracted: list[se2.Pose] = []

    def __deepcopy__(self, memo: dict[int, object]) -> JoinSearch:
        """Return an independent copy; maps are never changed and are shared."""
        other = JoinSearch(self.expected)
        other.agreements = copy.deepcopy(self.agreements)
        other._drive = copy.deepcopy(self._drive)
        other._maps, other._similarities = dict(self._maps), dict(self._similarities)
        other._retracted = list(self._retracted)
        return other

    def clear(self) -> None:
        """Discard all that was found: the map has been corrected."""
        self._maps, self._similarities = {}, {}
        self._drive.clear()
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

    def take_rejected(self, *, ended: bool = False) -> list[LoopDecision]:
        """Return the decisions against joins that looks agree on, as `LoopAgreement.take_rejected` does."""
        return [decision for search in self.agreements.values() for decision in search.take_rejected(ended=ended)]

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
            if agreement.refuted:
                reachable &= groups != group
        return None if reachable.all() else self._search_elsewhere(mapper, local_field, groups, connected, ~reachable)

    def _search_elsewhere(
        self,
        mapper: Mapper,
        local_field: LocalField,
        groups: Integers,
        connected: NDArray[np.bool_],
        apart: NDArray[np.bool_],
    ) -> LoopDecision | None:
        """Search for the last part of the map in those of the keyframes `apart` (k,), if a search is due.

        groups     (k,) number of the group of parts of each keyframe
        connected  (k,) keyframes of the last part
        """
        first = mapper.landmarks.parts.last_run_first
        if not self._drive.is_due(mapper, first):
            return None
        drive, found = self._drive.take(mapper, local_field, first), dict[int, Location]()
        for group in np.unique(groups[apart]).tolist():
            if group not in self._maps:
                self._maps[group] = scan_keyframes(mapper, local_field, groups == group)
            known, by_length = self._maps[group], self._similarities.setdefault(group, {})
            similarity = SelfSimilarity(mapper, local_field, groups == group, known, by_length)
            found[group] = locate(drive, known, self.expected, similarity=similarity.of)
        group = max(found, key=lambda number: found[number].support)
        location, others = found[group], [found[number].support for number in found if number != group]
        if not location.accepted or any(location.support - support < location.required for support in others):
            return None
        look = Look(mapper, local_field, Submaps(), groups == group, apart=True)
        if any(not differ(look, location.members[-1].motion, motion) for motion in self._retracted):
            return None
        old, since = np.flatnonzero(groups == group), int(connected.argmax())
        return decide_at(look, mapper, location, old, since, joins=True)
