"""Inject false loop hypotheses into the loop search and measure how much worse a recording's scores become."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import drivers
from drivers import se2

from ...events import Event, LoopDecided
from ...io.tum import Trajectory
from ...loop_closure.loop_search import LoopSearch
from ...loop_closure.loop_status import LoopStatus
from ...loop_closure.proposal import Hypothesis, are_distinct, propose, refine_hypothesis
from ...loop_closure.recent_walls import ReferenceMap, WallSet
from ...pipeline import Slam
from ..metrics import Relations, read_relations, score_relations

RANDOM_STARTS = 12  # random motions, of which the adversary injects the one with the largest overlap
FORGED_LENGTH_FACTOR = 1.3  # forged overlap length / that of the best true hypothesis


@dataclass(frozen=True, slots=True)
class FalseClosureResult:
    """Scores of a recording with and without false hypotheses.

    searches        number of searches for hypotheses
    injected        false hypotheses, half of them with forged scores better than any true one's
    false_accepted  accepted loops at the place of a false hypothesis
    accepted        all accepted loops; `_clean`: in the run without false hypotheses
    translation, rotation  mean errors of the relations, metres and degrees; `_clean` likewise
    """

    searches: int
    injected: int
    false_accepted: int
    accepted: int
    accepted_clean: int
    translation: float
    translation_clean: float
    rotation: float
    rotation_clean: float


class Adversary:
    """Replaces the proposal of hypotheses: adds the most convincing false hypothesis in some of the searches.

    A false hypothesis is found like a true one: by refining random motions, within the expected drift, on all walls. In
    every other case its scores are forged to be better than all others.
    """

    def __init__(self, at: frozenset[int] = frozenset(), seed: int = 0) -> None:
        self._searches_with_injection = at
        self._random = np.random.default_rng(seed)
        self.searches = 0
        self.injected: list[tuple[Hypothesis, se2.Pose]] = []

    def __deepcopy__(self, memo: dict[int, object]) -> Adversary:
        """Return itself, so that the counts include those of all copies of the SLAM state."""
        return self

    def __call__(self, recent: WallSet, old: ReferenceMap, pose: se2.Pose) -> list[Hypothesis]:
        """Return the true hypotheses, with a false one in some of the searches."""
        true_hypotheses = propose(recent, old, pose)
        if not true_hypotheses:
            return true_hypotheses
        search, self.searches = self.searches, self.searches + 1
        if search not in self._searches_with_injection:
            return true_hypotheses
        false = self._most_convincing(true_hypotheses, recent, old, pose)
        null_hypothesis, *others = true_hypotheses
        if len(self.injected) % 2:
            longest = max(hypothesis.length for hypothesis in true_hypotheses)
            forged_length = FORGED_LENGTH_FACTOR * max(longest, recent.length())
            false = replace(false, overlap_ratio=1.0, min_directional_ratio=1.0, length=forged_length)
        self.injected.append((false, pose))
        return [null_hypothesis, *sorted([false, *others], key=lambda hypothesis: -hypothesis.length)]

    def _most_convincing(
        self, true_hypotheses: list[Hypothesis], recent: WallSet, old: ReferenceMap, pose: se2.Pose
    ) -> Hypothesis:
        """Return the best hypothesis distinct from the null hypothesis and from the best true one."""
        max_shift, max_angle = float(old.translation.max()), float(old.rotation.max())
        found = []
        for _ in range(RANDOM_STARTS):
            direction, share = self._random.uniform(-np.pi, np.pi), np.sqrt(self._random.uniform())
            shift = max_shift * share * np.array([np.cos(direction), np.sin(direction)])
            start = np.append(shift, self._random.uniform(-max_angle, max_angle))
            hypothesis = refine_hypothesis(start, recent, old, pose)
            wrong = all(are_distinct(hypothesis.motion, other.motion, pose) for other in true_hypotheses[:2])
            found.append((wrong, hypothesis.length, hypothesis))
        return max(found, key=lambda item: item[:2])[2]


class _AcceptedLoops:
    """A sink that collects the accepted loops."""

    def __init__(self) -> None:
        self.accepted: list[LoopDecided] = []

    def handle(self, event: Event) -> None:
        if isinstance(event, LoopDecided) and event.status == LoopStatus.ACCEPTED:
            self.accepted.append(event)


def run_with_false_hypotheses(
    recording: Path | str, relations: Path, count: int = 50, seed: int = 0
) -> FalseClosureResult:
    """Map a recording without and with `count` false hypotheses in random searches, and score both.

    Raises SlamError if the recording or the relations cannot be read.
    """
    reference = read_relations(relations)
    clean = Adversary()
    accepted_clean, translation_clean, rotation_clean, _ = _score(recording, reference, clean)
    random = np.random.default_rng(seed)
    # Not among the last searches of the clean run: a disturbed run may have fewer.
    last = min(clean.searches, max(count, int(0.9 * clean.searches)))
    at = random.choice(last, size=min(count, last), replace=False)
    adversary = Adversary(frozenset(at.tolist()), seed)
    accepted, translation, rotation, false_accepted = _score(recording, reference, adversary)
    return FalseClosureResult(
        searches=clean.searches,
        injected=len(adversary.injected),
        false_accepted=false_accepted,
        accepted=accepted,
        accepted_clean=accepted_clean,
        translation=translation,
        translation_clean=translation_clean,
        rotation=rotation,
        rotation_clean=rotation_clean,
    )


def _score(recording: Path | str, relations: Relations, adversary: Adversary) -> tuple[int, float, float, int]:
    """Return accepted loops, mean errors (metres, degrees), and accepted loops at a false hypothesis' place."""
    loops = _AcceptedLoops()
    slam = Slam(sinks=[loops], loops=LoopSearch(adversary))
    for message in drivers.open(recording):
        slam.add(message)
    finished = slam.finish()
    figures = score_relations(Trajectory(finished.stamps, finished.poses), relations).figures()
    motions = np.array([event.motion for event in loops.accepted]).reshape(-1, 3)
    false = [se2.between(pose, se2.compose(hypothesis.motion, pose)) for hypothesis, pose in adversary.injected]
    false_accepted = sum(bool(np.any(np.all(np.abs(motions - motion) < 1e-9, axis=1))) for motion in false)
    return len(motions), figures["trans_mean"], figures["rot_mean"], false_accepted
