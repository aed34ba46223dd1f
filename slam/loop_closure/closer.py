"""Closing loops: look for old places every few metres, believe what is found twice, and make one map of both passes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from drivers import se2

from ..geometry.segments import Integers
from ..graph.backend import CLOSING_UPDATES
from ..mapping.mapper import Mapper
from .proposal import Hypothesis, propose
from .recent_walls import OLD_WAY, ReferenceMap, WallSet, recent_and_reference
from .verification import Verdict, VerificationContext, robot_motion, verify

INTERVAL = 1.5  # metres of driving between two looks
LEAST_NEW = 4.0  # metres of new wall in the constellation: where all has long been known, there is nothing to close
AGREEMENT, AGREEMENT_TURN = 0.3, np.radians(3.0)  # by which two looks at different places may differ
LEAST_FRESH = 6.0  # metres of wall on which a second look must rest that the first did not: else it is the same look
MEMORY = 25.0  # metres of driving after which a look no longer counts
CARRYING_SIGMAS = np.array([0.01, 0.01, np.radians(0.2)])  # of the relative pose that only carries the map over
LEAST_MERGED = 0.5  # share of the matched walls that must come together
STRANGE_OFFSET, STRANGE_HEADING = 0.10, np.radians(3.0)  # by which a wall that is the same may move across itself
SAME_OFFSET, SAME_HEADING = 0.20, np.radians(6.0)  # what may be left between two walls that are made one


@dataclass(frozen=True, slots=True, eq=False)
class LoopDecision:
    """What was decided about a place that looked known, when and why.

    candidate   running number
    keyframe    from which it was decided; `old` is a keyframe that saw the place before
    motion      [x, y, heading] by which the robot would move, in its own frame
    verdict     of the tests on this look
    status      "rejected", "held" (waits for a second look), "agreed" (two looks say the same), then "accepted" or, if
                the map does not come together, "rejected"; "retracted" if what was seen later contradicts it
    hypothesis  where the recent walls lie on the old map, and `pairs` (old, recent) of walls that are one by it
    merged      those of them that were made one
    shift       metres by which the last keyframe moved
    sight       what was compared: the recent walls and the old ones, as the map had them then
    """

    candidate: int
    keyframe: int
    old: int
    motion: se2.Pose
    verdict: Verdict
    status: str
    hypothesis: Hypothesis
    pairs: tuple[tuple[int, int], ...]
    merged: tuple[tuple[int, int], ...] = ()
    shift: float = 0.0
    sight: tuple[WallSet, WallSet] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PendingCandidate:
    """A look that passed all tests: by what motion, on which walls it rests, and after how many metres of driving."""

    motion: se2.Pose
    walls: frozenset[int]
    travel: float


@dataclass(frozen=True, slots=True, eq=False)
class LoopSearchState:
    """What a search for loops remembers: the way (metres) at the last look, looks that wait for another, how many
    places looked known so far, the motions that proved wrong, and the way when a look last contradicted another."""

    last_travel: float = 0.0
    held: tuple[PendingCandidate, ...] = ()
    candidates: int = 0
    refused: tuple[se2.Pose, ...] = ()
    contested: float = -MEMORY


Propose = Callable[[WallSet, ReferenceMap, se2.Pose], list[Hypothesis]]


class LoopCloser:
    """Looks for loops as the map grows. `propose` says where the last metres may lie on the old map, see there."""

    def __init__(self, propose: Propose = propose) -> None:
        self._propose = propose
        self.recall(LoopSearchState())

    @property
    def looks(self) -> LoopSearchState:
        """What it remembers."""
        return LoopSearchState(
            self._last_travel, tuple(self._held), self._candidates, tuple(self._refused), self._contested
        )

    def recall(self, looks: LoopSearchState) -> None:
        """Go on from what another search remembered."""
        self._last_travel, self._candidates = looks.last_travel, looks.candidates
        self._held, self._refused = list(looks.held), list(looks.refused)
        self._contested = looks.contested

    def search(self, mapper: Mapper) -> LoopDecision | None:
        """Consider the last keyframe. Nothing is changed: to `close` what two looks agree on is for whoever asked."""
        travel = mapper.travelled[-1]
        if travel - self._last_travel < INTERVAL:
            return None
        self._last_travel = travel
        travelled = np.array(mapper.travelled)
        recent, old = recent_and_reference(mapper.landmarks, mapper.pose, travelled)
        known = travel - travelled[mapper.landmarks.walls.rows["first_seen"][recent.walls]] > OLD_WAY
        if 2 * recent.half_length[~known].sum() < LEAST_NEW:
            return None
        hypotheses = self._propose(recent, old, mapper.pose)
        if len(hypotheses) < 2:
            return None
        best = hypotheses[1]
        pairs = _pairs(best, recent, old)
        if not pairs:
            return None
        seen = mapper.landmarks.walls.rows["last_seen"][[wall for wall, _ in pairs]]
        seen_from = int(np.bincount(np.minimum(seen, mapper.keyframe_count - 2)).argmax())  # before the last keyframe
        verdict = verify(hypotheses, _outlook(mapper, recent, old, seen_from))
        return self._decide(mapper, best, verdict, (recent, old.wall_set), pairs, seen_from)

    def forget(self) -> None:
        """The map has changed: what was seen before it no longer counts."""
        self._held, self._contested = [], -MEMORY

    def refuse(self, decision: LoopDecision) -> None:
        """A closure proved wrong: it is not to be found again."""
        self._refused.append(decision.hypothesis.motion)

    def _decide(
        self,
        mapper: Mapper,
        best: Hypothesis,
        verdict: Verdict,
        sight: tuple[WallSet, WallSet],
        pairs: tuple[tuple[int, int], ...],
        old: int,
    ) -> LoopDecision:
        self._candidates += 1
        motion = robot_motion(best, mapper.pose)
        if any(_agree(refused, best.motion, mapper.pose) for refused in self._refused):
            verdict = replace(verdict, accepted=False, reason="has proved wrong before")
        status = "rejected"
        if verdict.ambiguous:  # now that more was seen: so were the looks before it
            self._held = [look for look in self._held if not _agree(look.motion, best.motion, mapper.pose)]
        if verdict.accepted:
            status = "agreed" if self._borne_out(best, sight[0], mapper, near=verdict.near) else "held"
        keyframe = mapper.keyframe_count - 1
        return LoopDecision(self._candidates, keyframe, old, motion, verdict, status, best, pairs, sight=sight)

    def _borne_out(self, best: Hypothesis, recent: WallSet, mapper: Mapper, *, near: bool) -> bool:
        """Whether an earlier look at other walls found the same motion, and none since found another one.

        It may have been at the same walls if the motion is near and no other one was found lately.
        """
        travel = mapper.travelled[-1]
        self._held = [look for look in self._held if travel - look.travel < MEMORY]
        if not all(_agree(look.motion, best.motion, mapper.pose) for look in self._held):
            self._held, self._contested = [], travel
        undisputed = near and travel - self._contested > MEMORY
        matched = best.matches >= 0
        kept = mapper.landmarks.walls.rows["merged_into"]
        for look in self._held:
            fresh = matched & ~np.isin(recent.walls, kept[list(look.walls)])
            if undisputed or 2 * recent.half_length[fresh].sum() >= LEAST_FRESH:
                return True
        self._held.append(PendingCandidate(best.motion, frozenset(recent.walls[matched].tolist()), travel))
        return False


def close(mapper: Mapper, decision: LoopDecision) -> LoopDecision:
    """Bring the last keyframe to where the decision has it, then make one of each pair of walls.

    The relative pose only carries the map over: once the walls are one they hold it, and it is taken out again, because
    it was made of the same observations. Where too few of them come together the decision is a rejection, and the
    mapper is of no more use.
    """
    before, last = mapper.pose, mapper.keyframe_count - 1
    there = se2.compose(decision.hypothesis.motion, mapper.pose)
    relative = se2.between(mapper.graph.keyframe_pose(decision.old), there)
    strangers, since = misassociated_walls(mapper, decision)
    mapper.graph.forget_observations(frozenset(strangers.tolist()), since)
    mapper.landmarks.walls.rows["last_seen"][strangers] = since - 1
    carrying = mapper.graph.close_loop(decision.old, last, relative, CARRYING_SIGMAS)
    mapper.read_back_all()
    rows = mapper.landmarks.walls.rows
    pairs = list(
        dict.fromkeys(
            (int(rows["merged_into"][old]), int(rows["merged_into"][recent])) for old, recent in decision.pairs
        )
    )
    joined = [(old, recent) for old, recent in pairs if old != recent and together(rows[old], rows[recent])]
    if len(joined) < LEAST_MERGED * len(pairs):
        refused = replace(decision.verdict, accepted=False, reason="the map does not come together")
        return replace(decision, status="rejected", verdict=refused)
    for old, recent in joined:
        if rows["merged_into"][old] == old and rows["merged_into"][recent] == recent:
            mapper.merge_walls(old, recent)
    mapper.graph.update()
    mapper.graph.settle(CLOSING_UPDATES)
    mapper.graph.remove_factors(carrying)
    mapper.read_back_all()
    shift = float(np.hypot(*(mapper.pose - before)[:2]))
    return replace(decision, status="accepted", merged=tuple(joined), shift=shift)


def together(wall: np.void, other: np.void) -> bool:
    """Whether two walls lie on one line, in the middle of the second."""
    left = se2.between(wall["frame"], other["frame"])
    offset = left[1] + 0.5 * (other["low"] + other["high"]) * np.sin(left[2])
    return bool(abs(offset) < SAME_OFFSET and abs(left[2]) < SAME_HEADING)


def misassociated_walls(mapper: Mapper, decision: LoopDecision) -> tuple[Integers, int]:
    """Walls that were taken for others by the pass that ends in a closure, and the keyframe where it began.

    Drift has let some old walls be taken for others that happened to lie there; such observations would hold the map
    where it is. A wall seen both before and during this pass must not move across itself with the pass; if it does,
    what this pass saw was not it.
    """
    walls = mapper.landmarks.walls.rows
    travelled = np.array(mapper.travelled)
    new = [int(walls["first_seen"][recent]) for _, recent in decision.pairs]
    since = min(
        (keyframe for keyframe in new if travelled[-1] - travelled[keyframe] < OLD_WAY), default=mapper.keyframe_count
    )
    both = np.flatnonzero(walls["in_graph"] & (walls["first_seen"] < since) & (walls["last_seen"] >= since))
    moved = se2.between(walls["frame"][both], se2.compose(decision.hypothesis.motion, walls["frame"][both]))
    moved = moved.reshape(-1, 3)
    return both[(np.abs(moved[:, 1]) > STRANGE_OFFSET) | (np.abs(moved[:, 2]) > STRANGE_HEADING)], since


def _pairs(best: Hypothesis, recent: WallSet, old: ReferenceMap) -> tuple[tuple[int, int], ...]:
    """(old, recent) identities of walls that are one by a hypothesis and are not known to be."""
    matched = [(old.wall_set.walls[j], recent.walls[i]) for i, j in enumerate(best.matches) if j >= 0]
    return tuple((int(wall), int(other)) for wall, other in matched if wall != other)


def _outlook(mapper: Mapper, recent: WallSet, old: ReferenceMap, seen_from: int) -> VerificationContext:
    """What a place is judged by that the keyframe `seen_from` saw."""
    views = [(mapper.graph.keyframe_pose(keyframe), segments) for keyframe, segments in mapper.views]
    last = mapper.keyframe_count - 1
    uncertainty = cache(lambda: mapper.relative_covariance(seen_from, last))
    return VerificationContext(recent, old, mapper.landmarks, mapper.pose, views, uncertainty)


def _agree(motion: se2.Pose, other: se2.Pose, pose: se2.Pose) -> bool:
    difference = se2.between(se2.compose(motion, pose), se2.compose(other, pose))
    return bool(np.hypot(difference[0], difference[1]) < AGREEMENT and abs(difference[2]) < AGREEMENT_TURN)
