"""False candidates forced into the loop closer's proposals: how much worse a recording comes out for them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import drivers
from drivers import se2

from ...events import Event, LoopDecided
from ...io.tum import Trajectory
from ...loop_closure.closer import LoopCloser
from ...loop_closure.proposal import Hypothesis, distinct, propose, refined
from ...loop_closure.recent_walls import ReferenceMap, WallSet
from ...pipeline import Slam
from ..metrics import Relations, read_relations, score_relations

STARTS = 12  # random motions of which the adversary takes the one that explains most
OUTDONE = 1.3  # times as much as the best honest candidate that a candidate with forged scores claims to explain


@dataclass(frozen=True, slots=True)
class Outcome:
    """A recording with and without false candidates.

    looks       how often the closer asked for candidates
    forced      false candidates it was given, half of them with forged scores better than any honest one's
    taken       closures made to where a false candidate led
    accepted    closures made in all, and in the clean run
    translation, rotation  mean errors of the relations, metres and degrees, and those of the clean run
    """

    looks: int
    forced: int
    taken: int
    accepted: int
    accepted_clean: int
    translation: float
    translation_clean: float
    rotation: float
    rotation_clean: float


class Adversary:
    """Proposes as the closer does, and at some looks adds the most convincing wrong place it can find.

    A wrong place is found as a right one is: by refining random motions, within what drift allows, on all walls. At
    every other look its scores are forged besides, so that it is the best of all and has no rival.
    """

    def __init__(self, at: frozenset[int] = frozenset(), seed: int = 0) -> None:
        self._at = at
        self._random = np.random.default_rng(seed)
        self.looks = 0
        self.forced: list[tuple[Hypothesis, se2.Pose]] = []

    def __deepcopy__(self, memo: dict[int, object]) -> Adversary:
        """It keeps count over all copies of the belief that it deceives."""
        return self

    def __call__(self, recent: WallSet, old: ReferenceMap, pose: se2.Pose) -> list[Hypothesis]:
        """The honest candidates, and a false one at some looks."""
        honest = propose(recent, old, pose)
        if not honest:
            return honest
        look, self.looks = self.looks, self.looks + 1
        if look not in self._at:
            return honest
        false = self._most_convincing(honest, recent, old, pose)
        stay, *others = honest
        if len(self.forced) % 2:
            most = max(hypothesis.length for hypothesis in honest)
            false = replace(false, overlap_ratio=1.0, weakest=1.0, length=OUTDONE * max(most, recent.length()))
        self.forced.append((false, pose))
        return [stay, *sorted([false, *others], key=lambda hypothesis: -hypothesis.length)]

    def _most_convincing(
        self, honest: list[Hypothesis], recent: WallSet, old: ReferenceMap, pose: se2.Pose
    ) -> Hypothesis:
        """The strongest place away from where the robot is believed to be and from the best honest candidate."""
        reach, turn = float(old.translation.max()), float(old.rotation.max())
        found = []
        for _ in range(STARTS):
            direction, share = self._random.uniform(-np.pi, np.pi), np.sqrt(self._random.uniform())
            shift = reach * share * np.array([np.cos(direction), np.sin(direction)])
            start = np.append(shift, self._random.uniform(-turn, turn))
            hypothesis = refined(start, recent, old, pose)
            wrong = all(distinct(hypothesis.motion, other.motion, pose) for other in honest[:2])
            found.append((wrong, hypothesis.length, hypothesis))
        return max(found, key=lambda item: item[:2])[2]


class _Closures:
    """A sink that notes the closures made: the robot's frame before is not told, so only where candidates led."""

    def __init__(self) -> None:
        self.accepted: list[LoopDecided] = []

    def handle(self, event: Event) -> None:
        if isinstance(event, LoopDecided) and event.status == "accepted":
            self.accepted.append(event)


def run(recording: Path | str, relations: Path, count: int = 50, seed: int = 0) -> Outcome:
    """Map a recording as it is, then with `count` false candidates at random looks, and score both.

    Raises SlamError where the recording or the relations cannot be read.
    """
    true = read_relations(relations)
    clean = Adversary()
    accepted_clean, translation_clean, rotation_clean, _ = _score(recording, true, clean)
    random = np.random.default_rng(seed)
    # not among the last looks of the clean run: one that is deceived may have fewer
    within = min(clean.looks, max(count, int(0.9 * clean.looks)))
    at = random.choice(within, size=min(count, within), replace=False)
    adversary = Adversary(frozenset(at.tolist()), seed)
    accepted, translation, rotation, taken = _score(recording, true, adversary)
    return Outcome(
        looks=clean.looks,
        forced=len(adversary.forced),
        taken=taken,
        accepted=accepted,
        accepted_clean=accepted_clean,
        translation=translation,
        translation_clean=translation_clean,
        rotation=rotation,
        rotation_clean=rotation_clean,
    )


def _score(recording: Path | str, relations: Relations, adversary: Adversary) -> tuple[int, float, float, int]:
    """Closures made, mean errors (metres, degrees), and closures made to where a false candidate led."""
    closures = _Closures()
    slam = Slam(sinks=[closures], loops=LoopCloser(adversary))
    for message in drivers.open(recording):
        slam.add(message)
    finished = slam.finish()
    figures = score_relations(Trajectory(finished.stamps, finished.poses), relations).figures()
    motions = np.array([event.motion for event in closures.accepted]).reshape(-1, 3)
    false = [se2.between(pose, se2.compose(forced.motion, pose)) for forced, pose in adversary.forced]
    taken = sum(bool(np.any(np.all(np.abs(motions - motion) < 1e-9, axis=1))) for motion in false)
    return len(motions), figures["trans_mean"], figures["rot_mean"], taken
