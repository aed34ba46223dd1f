"""Inject false matches into the loop search and measure how much worse a recording's scores become."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import drivers
from drivers import se2

from ...events import Event, LoopDecided
from ...io.tum import Trajectory
from ...loop_closure.agreement import LoopAgreement
from ...loop_closure.look import Look
from ...loop_closure.loop_status import LoopStatus
from ...loop_closure.submap_search import SubmapMatch, are_distinct, improve
from ...pipeline import Slam
from ..metrics import Relations, read_relations, score_relations

RANDOM_STARTS = 12  # random poses, of which the adversary injects the best match
MAX_SHIFT, MAX_TURN = 3.0, np.radians(20.0)  # metres, radians: of the random poses from the estimate
EARLY = 0.9  # share of the searches of the normal run in which false matches are injected: a disturbed run has fewer


@dataclass(frozen=True, slots=True)
class FalseClosureResult:
    """Scores of a recording with and without false matches.

    searches        number of searches of an old place
    injected        false matches, half of them with forged scores better than any true one's
    false_accepted  accepted loops at the place of a false match
    accepted        all accepted loops; `_clean`: in the run without false matches
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
    """Replaces the search of an old place: adds the most convincing false match in some of the searches.

    A false match is found like a true one: by improving random poses around the estimate. In every other case its
    scores are forged: all points are known and fit, and the position is well determined.
    """

    def __init__(self, at: frozenset[int] = frozenset(), seed: int = 0) -> None:
        self._searches_with_injection = at
        self._random = np.random.default_rng(seed)
        self.searches = 0
        self.injected: list[se2.Pose] = []  # motions in the map, as those of hypotheses

    def __deepcopy__(self, memo: dict[int, object]) -> Adversary:
        """Return itself, so that the counts include those of all copies of the SLAM state."""
        return self

    def __call__(self, look: Look, old: int) -> list[SubmapMatch]:
        """Return the true matches, with a false one in some of the searches."""
        true = list(look.search(old))
        search, self.searches = self.searches, self.searches + 1
        if search not in self._searches_with_injection:
            return true
        false = self._most_convincing(look, old, true)
        if len(self.injected) % 2:
            false = replace(false, fit=1.0, known=1.0, covariance=np.diag([0.01, 0.01, 0.001]) ** 2)
        self.injected.append(look.motion(old, false.pose))
        return [*true, false]

    def _most_convincing(self, look: Look, old: int, true: Sequence[SubmapMatch]) -> SubmapMatch:
        """Return the best match distinct from the estimate and from the true matches."""
        estimate = look.relative(old, np.zeros(3))
        limits = np.array([MAX_SHIFT, MAX_SHIFT, MAX_TURN])
        found = []
        for _ in range(RANDOM_STARTS):
            start = se2.compose(estimate, self._random.uniform(-limits, limits))
            match = improve(look.submap, look.old_submap(old), start)
            wrong = all(are_distinct(match.pose, pose) for pose in (estimate, *(other.pose for other in true)))
            found.append((wrong, match.score, match))
        return max(found, key=lambda item: item[:2])[2]


class AcceptedLoops:
    """A sink that counts the accepted loops, and those of them at the place of a false match injected before."""

    handled = (LoopDecided,)

    def __init__(self, adversary: Adversary) -> None:
        self._adversary = adversary
        self.accepted = self.false_accepted = 0

    def handle(self, event: Event) -> None:
        """Count an accepted loop."""
        if not isinstance(event, LoopDecided) or event.status != LoopStatus.ACCEPTED:
            return
        self.accepted += 1
        assert event.correction is not None
        before = event.correction.keyframe_poses_before[event.index]
        after = se2.compose(before, event.motion)
        # Not of later false matches: some motion of a long drive is like that of the loop by chance.
        false = [se2.compose(motion, before) for motion in self._adversary.injected]
        self.false_accepted += not all(are_distinct(after, pose) for pose in false)


def run_with_false_matches(
    recording: Path | str, relations: Path, count: int = 50, seed: int = 0
) -> FalseClosureResult:
    """Map a recording without and with `count` false matches in random searches, and score both.

    Raises SlamError if the recording or the relations cannot be read.
    """
    reference = read_relations(relations)
    clean = Adversary()
    accepted_clean, translation_clean, rotation_clean, _ = _score(recording, reference, clean)
    random = np.random.default_rng(seed)
    last = int(EARLY * clean.searches)
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
    """Return accepted loops, mean errors (metres, degrees), and accepted loops at the place of a false match."""
    loops = AcceptedLoops(adversary)
    slam = Slam(sinks=[loops], loops=LoopAgreement(adversary))
    for message in drivers.open(recording):
        slam.add(message)
    finished = slam.finish()
    figures = score_relations(Trajectory(finished.stamps, finished.poses), relations).figures()
    return loops.accepted, figures["trans_mean"], figures["rot_mean"], loops.false_accepted
