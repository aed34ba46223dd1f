"""Search for loop closures: propose and verify a candidate every few metres, and confirm it by a second one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from drivers import se2

from ..mapping.mapper import Mapper
from .decision import LoopDecision
from .loop_status import LoopStatus
from .proposal import Hypothesis, propose
from .recent_walls import REFERENCE_DISTANCE, ReferenceMap, WallSet, select_recent_and_reference
from .verification import Verdict, VerificationContext, robot_motion, verify

# Travelled metres between two searches. Origin: chosen, a fraction of RECENT_DISTANCE; not measured.
LOOP_SEARCH_INTERVAL = 1.5
# Metres of new wall that the recent walls must contain: in a well-known place there is no loop to close.
# Origin: tuned on Intel, fr079, CSAIL.
MIN_NEW_LENGTH = 4.0
# Metres by which the robot's poses under two agreeing motions may differ. Origin: chosen; not measured.
AGREEMENT_SHIFT = 0.3
# Radians, likewise. Origin: chosen; not measured.
AGREEMENT_TURN = np.radians(3.0)
# Metres of wall that a confirming candidate must match and the pending one did not: candidates that rest on the same
# walls agree necessarily. Origin: tuned on simulated drives.
MIN_INDEPENDENT_LENGTH = 6.0
# Travelled metres after which a pending candidate expires, and for which a disagreement counts.
# Origin: tuned on simulated drives.
PENDING_DISTANCE = 25.0


@dataclass(frozen=True, slots=True, eq=False)
class PendingCandidate:
    """Candidate that passed all checks and waits for confirmation.

    motion     [x, y, heading] of the recent walls onto the reference map, in the map
    walls      ids of the recent walls that matched
    travelled  travelled distance when it was found, metres
    """

    motion: se2.Pose
    walls: frozenset[int]
    travelled: float


@dataclass(frozen=True, slots=True, eq=False)
class LoopSearchState:
    """State of a loop search, as it is saved with a session.

    last_search        travelled distance at the last search, metres
    pending            candidates that wait for confirmation
    candidates         number of candidates so far
    retracted          motions of retracted closures, which are not accepted again
    last_disagreement  travelled distance when a candidate last disagreed with a pending one, metres
    """

    last_search: float = 0.0
    pending: tuple[PendingCandidate, ...] = ()
    candidates: int = 0
    retracted: tuple[se2.Pose, ...] = ()
    last_disagreement: float = -PENDING_DISTANCE


Propose = Callable[[WallSet, ReferenceMap, se2.Pose], list[Hypothesis]]


class LoopSearch:
    """Search for loop closures while the map grows. `propose` returns the hypotheses, the null hypothesis first."""

    def __init__(self, propose: Propose = propose) -> None:
        self._propose = propose
        self.restore(LoopSearchState())

    @property
    def state(self) -> LoopSearchState:
        """State to be saved."""
        return LoopSearchState(
            self._last_search, tuple(self._pending), self._candidates, tuple(self._retracted), self._last_disagreement
        )

    def restore(self, state: LoopSearchState) -> None:
        """Continue from a saved state."""
        self._last_search, self._candidates = state.last_search, state.candidates
        self._pending, self._retracted = list(state.pending), list(state.retracted)
        self._last_disagreement = state.last_disagreement

    def search(self, mapper: Mapper) -> LoopDecision | None:
        """Search for a loop at the last keyframe; None if no search is due or nothing is found.

        The map is not changed; closing a CONFIRMED loop is left to the caller.
        """
        distance = mapper.travelled[-1]
        if distance - self._last_search < LOOP_SEARCH_INTERVAL:
            return None
        self._last_search = distance
        travelled = np.array(mapper.travelled)
        recent, reference = select_recent_and_reference(mapper.landmarks, mapper.pose, travelled)
        since_first_seen = distance - travelled[mapper.landmarks.walls.rows["first_seen"][recent.walls]]
        if 2 * recent.half_length[~(since_first_seen > REFERENCE_DISTANCE)].sum() < MIN_NEW_LENGTH:
            return None
        hypotheses = self._propose(recent, reference, mapper.pose)
        if len(hypotheses) < 2:
            return None
        best = hypotheses[1]
        pairs = _matched_pairs(best, recent, reference)
        if not pairs:
            return None
        seen = mapper.landmarks.walls.rows["last_seen"][[wall for wall, _ in pairs]]
        old_keyframe = int(np.bincount(np.minimum(seen, mapper.keyframe_count - 2)).argmax())  # never the last one
        verdict = verify(hypotheses, _verification_context(mapper, recent, reference, old_keyframe))
        return self._decide(mapper, best, verdict, (recent, reference.wall_set), pairs, old_keyframe)

    def clear_pending(self) -> None:
        """Discard pending candidates and disagreements, which do not hold for a corrected map."""
        self._pending, self._last_disagreement = [], -PENDING_DISTANCE

    def next_candidate(self) -> int:
        """Return the number of a new candidate."""
        self._candidates += 1
        return self._candidates

    def is_excluded(self, motion: se2.Pose, pose: se2.Pose) -> bool:
        """True if the motion of a robot at `pose` is that of a retracted closure."""
        return any(_motions_agree(retracted, motion, pose) for retracted in self._retracted)

    def exclude(self, decision: LoopDecision) -> None:
        """Reject the motion of a retracted closure from now on."""
        self._retracted.append(decision.hypothesis.motion)

    def _decide(
        self,
        mapper: Mapper,
        best: Hypothesis,
        verdict: Verdict,
        compared: tuple[WallSet, WallSet],
        pairs: tuple[tuple[int, int], ...],
        old_keyframe: int,
    ) -> LoopDecision:
        """Decide on a verified candidate."""
        candidate = self.next_candidate()
        motion = robot_motion(best, mapper.pose)
        if self.is_excluded(best.motion, mapper.pose):
            verdict = replace(verdict, accepted=False, reason="was retracted before")
        status = LoopStatus.REJECTED
        if verdict.ambiguous:  # with more walls seen: pending candidates with this motion were ambiguous as well
            self._pending = [
                pending for pending in self._pending if not _motions_agree(pending.motion, best.motion, mapper.pose)
            ]
        if verdict.accepted:
            confirmed = self._confirm(best, compared[0], mapper, relaxed=verdict.relaxed)
            status = LoopStatus.CONFIRMED if confirmed else LoopStatus.PENDING
        keyframe = mapper.keyframe_count - 1
        return LoopDecision(candidate, keyframe, old_keyframe, motion, verdict, status, best, pairs, compared=compared)

    def _confirm(self, best: Hypothesis, recent: WallSet, mapper: Mapper, *, relaxed: bool) -> bool:
        """Confirm a candidate by a pending one with the same motion; else add it to the pending ones.

        The pending candidate must rest on other walls, and no candidate since may have disagreed. It may rest on the
        same walls if `relaxed` (see `Verdict`) and no candidate disagreed within PENDING_DISTANCE.
        """
        distance = mapper.travelled[-1]
        self._pending = [pending for pending in self._pending if distance - pending.travelled < PENDING_DISTANCE]
        if not all(_motions_agree(pending.motion, best.motion, mapper.pose) for pending in self._pending):
            self._pending, self._last_disagreement = [], distance
        undisputed = relaxed and distance - self._last_disagreement > PENDING_DISTANCE
        matched = best.matches >= 0
        merged_into = mapper.landmarks.walls.rows["merged_into"]
        for pending in self._pending:
            independent = matched & ~np.isin(recent.walls, merged_into[list(pending.walls)])
            if undisputed or 2 * recent.half_length[independent].sum() >= MIN_INDEPENDENT_LENGTH:
                return True
        self._pending.append(PendingCandidate(best.motion, frozenset(recent.walls[matched].tolist()), distance))
        return False


def _matched_pairs(best: Hypothesis, recent: WallSet, reference: ReferenceMap) -> tuple[tuple[int, int], ...]:
    """Return the landmark ids (old, recent) of matched walls that are different landmarks so far."""
    matched = [(reference.wall_set.walls[j], recent.walls[i]) for i, j in enumerate(best.matches) if j >= 0]
    return tuple((int(wall), int(other)) for wall, other in matched if wall != other)


def _verification_context(
    mapper: Mapper, recent: WallSet, reference: ReferenceMap, old_keyframe: int
) -> VerificationContext:
    """Return the data for verifying a place that the keyframe `old_keyframe` saw."""
    views = [(mapper.graph.keyframe_pose(keyframe), segments) for keyframe, segments in mapper.recent_segments]
    last = mapper.keyframe_count - 1
    uncertainty = cache(lambda: mapper.relative_covariance(old_keyframe, last))
    return VerificationContext(recent, reference, mapper.landmarks, mapper.pose, views, uncertainty)


def _motions_agree(motion: se2.Pose, other: se2.Pose, pose: se2.Pose) -> bool:
    """True if two motions move a robot at `pose` to nearly the same pose."""
    difference = se2.between(se2.compose(motion, pose), se2.compose(other, pose))
    return bool(np.hypot(difference[0], difference[1]) < AGREEMENT_SHIFT and abs(difference[2]) < AGREEMENT_TURN)
