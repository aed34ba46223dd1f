"""Loop closure by agreement: follow each possible correction of the estimate over several looks at old places.

Every few metres the points of the last keyframes are matched with old places (see `submap_search`); this is a look.
Each match that the estimate's uncertainty admits is a hypothesis: a motion that would move the robot onto the old map.
One match may be wrong, as places look alike, so each later look tests all hypotheses again. A loop is closed if enough
looks support its hypothesis, at least two of them without common points, and if few contradict it or support a rival.
Mangelson et al. (2018) also accept sets of matches, by pairwise consistency. The estimate itself is the first
hypothesis: if it fits, the robot has returned, and nothing is corrected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from drivers import se2

from ..geometry.segments import Floats, Integers
from ..localisation.local_field import REFERENCE_DISTANCE, LocalField
from ..mapping.mapper import Mapper
from ..matching.point_matcher import SEARCH_FIT
from .decision import LoopDecision, LoopMatch
from .loop_status import LoopStatus
from .proposal import Hypothesis
from .submap_search import MAX_SHIFT, Submap, SubmapMatch, are_distinct, build_submap, improve, search_submap
from .verification import Verdict

# Metres of driving between two looks. Origin: chosen, a third of a submap; not measured.
SEARCH_INTERVAL = 2.0
# Metres of driving whose keyframes are the submap. Looks farther apart have no point in common.
# Origin: chosen, about the size of a room; not measured.
SUBMAP_LENGTH = 6.0
# Metres of driving between the middles of the submaps of old places. Origin: definition, half a submap.
SUBMAP_INTERVAL = SUBMAP_LENGTH / 2.0
# Submaps of old places that are kept. Origin: chosen, for two places at a look, and those of the look before.
MAX_SUBMAPS = 4
# Metres from the middle of a submap to the sides of its field. Origin: chosen, a usual range indoors; not measured.
SUBMAP_HALF_WIDTH = 15.0
# Least fit of a match, and least share of the submap in space that the old place has seen.
# Origin: chosen, not measured.
MIN_LOOP_FIT = 0.75
MIN_KNOWN = 0.4  # Origin: as MIN_LOOP_FIT.
# Metres: largest standard deviation of a match in any direction; along a bare corridor it is larger.
# Origin: definition, as MAX_LINK_SIGMA.
MAX_MATCH_SIGMA = 0.17
# Looks that must support a hypothesis. Origin: definition, the least number of which two have no point in common.
MIN_SUPPORT = 4
# Looks that support a hypothesis for each that contradicts it, and for each that supports a rival.
# Origin: chosen, doors and people make a true place look wrong now and then; not measured.
SUPPORT_RATIO = 3.0
# Share of the best match's score from which another one at the same look is supported too.
# Origin: chosen; not measured.
RIVAL_SCORE = 0.9
# Metres of driving after the last support for which a hypothesis is followed. Origin: chosen; not measured.
MEMORY = 40.0
# Largest squared Mahalanobis distance. Origin: chi-square, 3 dof, 99.9 %.
MAX_SQUARED_DISTANCE = 16.3
# Metres, metres, radians: errors of the estimate that its covariance does not contain, such as slips that were not
# recognised. Origin: chosen; not measured.
UNMODELLED_SIGMAS = np.array([0.3, 0.3, 0.05])


@dataclass(slots=True, eq=False)
class LoopHypothesis:
    """Motion [x, y, heading] that would move the robot in the map, with the looks for and against it.

    support         latest match of each look that supports it
    contradictions  metres driven up to each look that contradicts it
    """

    motion: se2.Pose
    support: list[LoopMatch] = field(default_factory=list)
    contradictions: list[float] = field(default_factory=list)

    @property
    def span(self) -> float:
        """Metres of driving between the first and the last look that support it."""
        return self.support[-1].travelled - self.support[0].travelled if self.support else 0.0

    @property
    def mean_fit(self) -> float:
        """Mean fit of the looks that support it."""
        return float(np.mean([match.fit for match in self.support]))

    def copy(self) -> LoopHypothesis:
        """Return an independent copy."""
        return LoopHypothesis(self.motion, list(self.support), list(self.contradictions))

    def support_since(self, travelled: float) -> int:
        """Return the number of looks that support it from a distance driven (metres) on."""
        return sum(match.travelled >= travelled for match in self.support)


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """A hypothesis that enough looks agree on.

    matches         those that support it
    motion          [x, y, heading] of the robot's surroundings in the map
    runner_up       looks that support the strongest rival, as a share
    contradictions  number of looks that contradict it
    since           metres driven up to where the estimate may have become wrong
    """

    matches: tuple[LoopMatch, ...]
    motion: se2.Pose
    runner_up: float
    contradictions: int
    since: float

    def decision(self, candidate: int, mapper: Mapper) -> LoopDecision:
        """Return the decision to close the loop."""
        pose, since = mapper.pose, int(np.searchsorted(mapper.travelled, self.since))
        last = self.matches[-1]
        distance = last.travelled - self.matches[0].travelled
        verdict = Verdict(
            accepted=True,
            reason=f"{len(self.matches)} submap matches over {distance:.0f} m agree",
            overlap_ratio=last.fit,
            matches=len(self.matches),
            runner_up=self.runner_up,
            sigma=float(np.sqrt(np.linalg.eigvalsh(last.covariance[:2, :2])[-1])),
            contradicted=self.contradictions / (len(self.matches) + self.contradictions),
            beats_null_hypothesis=True,
            ambiguous=False,
            relaxed=False,
        )
        hypothesis = Hypothesis(
            self.motion,
            last.fit,
            0.0,
            1.0,
            np.asarray(np.linalg.inv(last.covariance), dtype=np.float64),
            np.zeros(0, dtype=np.int64),
        )
        motion = se2.between(pose, se2.compose(self.motion, pose))
        return LoopDecision(
            candidate,
            last.keyframe,
            last.old,
            motion,
            verdict,
            LoopStatus.CONFIRMED,
            hypothesis,
            (),
            matches=self.matches,
            since=since,
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """The recent submap beside that of an old place; `last` and `old` are the keyframes of their frames."""

    last: int
    old: int
    travelled: float
    submap: Submap
    reference: Submap
    pose: se2.Pose
    old_pose: se2.Pose
    covariance: Floats

    def relative(self, motion: se2.Pose) -> se2.Pose:
        """Return the pose of the submap in the old one under a hypothesis."""
        return se2.between(self.old_pose, se2.compose(motion, self.pose))

    def motion(self, relative: se2.Pose) -> se2.Pose:
        """Return the motion that a match implies."""
        return se2.compose(se2.compose(self.old_pose, relative), se2.inverse(self.pose))

    def loop_match(self, match: SubmapMatch) -> LoopMatch:
        return LoopMatch(self.last, self.old, match.pose, match.covariance, self.travelled, match.fit, match.known)

    def admits(self, relative: se2.Pose) -> bool:
        """True if the estimate's uncertainty admits a pose of the submap."""
        error = se2.between(self.relative(np.zeros(3)), relative)
        return bool(error @ np.linalg.solve(self.covariance, error) < MAX_SQUARED_DISTANCE)


class LoopAgreement:
    """Hypotheses of the last metres, and the search for new ones."""

    def __init__(self) -> None:
        self._last_search = 0.0
        self._submaps: dict[int, Submap] = {}  # of the last old places, by the keyframe in their middle
        self.clear()

    def __deepcopy__(self, memo: dict[int, object]) -> LoopAgreement:
        """Return an independent copy; matches and submaps are never changed and are shared."""
        other = LoopAgreement()
        other._last_search, other._submaps = self._last_search, dict(self._submaps)
        other._returns = list(self._returns)
        other._estimate, other._hypotheses = self._estimate.copy(), [h.copy() for h in self._hypotheses]
        return other

    def clear(self) -> None:
        """Discard all hypotheses: the map has been corrected."""
        self._submaps.clear()
        self._estimate = LoopHypothesis(np.zeros(3))
        self._returns: list[float] = []  # metres driven up to each look that agrees with the estimate
        self._hypotheses: list[LoopHypothesis] = []

    def search(self, mapper: Mapper, local_field: LocalField) -> Agreement | None:
        """Look for the last keyframe's place in old parts of the map; return a hypothesis to be accepted, if any."""
        last, travelled = mapper.keyframe_count - 1, np.asarray(mapper.travelled)
        now = float(travelled[last])
        if now - self._last_search < SEARCH_INTERVAL:
            return None
        self._last_search = now
        self._hypotheses = [h for h in self._hypotheses if now - h.support[-1].travelled < MEMORY]
        self._returns = [at for at in self._returns if now - at < MEMORY]
        places = _old_places(mapper.keyframe_poses, travelled, local_field.inserted, last)
        if not places:
            return None
        recent = np.flatnonzero(travelled > now - SUBMAP_LENGTH)
        submap = _submap(mapper, local_field, recent, last)
        looks = [self._look(mapper, local_field, submap, old) for old in places]
        self._vote(looks, local_field)
        return self._accepted(looks)

    def _look(self, mapper: Mapper, local_field: LocalField, submap: Submap, old: int) -> _Look:
        """Return the look at an old keyframe; the submap around it is built if it is not among the last ones."""
        last, travelled = mapper.keyframe_count - 1, np.asarray(mapper.travelled)
        old = int(np.searchsorted(travelled, travelled[old] // SUBMAP_INTERVAL * SUBMAP_INTERVAL))
        if old not in self._submaps:
            around = np.abs(travelled - travelled[old]) < SUBMAP_LENGTH
            around &= travelled < travelled[last] - SUBMAP_LENGTH
            self._submaps = dict([*self._submaps.items()][1 - MAX_SUBMAPS :])
            self._submaps[old] = _submap(mapper, local_field, np.flatnonzero(around), old)
        covariance = mapper.relative_covariance(old, last) + np.diag(UNMODELLED_SIGMAS**2)
        poses = mapper.keyframe_poses
        return _Look(last, old, float(travelled[last]), submap, self._submaps[old], poses[last], poses[old], covariance)

    def _vote(self, looks: Sequence[_Look], local_field: LocalField) -> None:
        """Let the looks at one place along the drive support or contradict all hypotheses, and propose new ones."""
        hypotheses = [self._estimate, *self._hypotheses]
        support: dict[int, tuple[_Look, SubmapMatch]] = {}
        contradicted: set[int] = set()
        for look in looks:
            starts = [look.relative(h.motion) for h in hypotheses]
            matches = [improve(look.submap, look.reference, start) for start in starts]
            fitting = [_fits(m) and not are_distinct(m.pose, start) for m, start in zip(matches, starts, strict=True)]
            new = [m for m in self._search(look) if all(are_distinct(m.pose, start) for start in starts)]
            scores = [m.score for m, fits in zip(matches, fitting, strict=True) if fits] + [m.score for m in new]
            least = RIVAL_SCORE * max(scores, default=0.0)
            for number, (match, fits) in enumerate(zip(matches, fitting, strict=True)):
                if fits and match.score >= least and _is_determined(match):
                    support[number] = look, match
                elif match.known >= MIN_KNOWN and not (fits and match.score >= least):
                    contradicted.add(number)
            self._hypotheses += [
                LoopHypothesis(look.motion(m.pose), [look.loop_match(m)]) for m in new if m.score >= least
            ]
        for number, hypothesis in enumerate(hypotheses):
            if number in support:
                self._add_support(hypothesis, *support[number], local_field)
            elif number in contradicted:
                hypothesis.contradictions.append(looks[0].travelled)

    def _add_support(
        self, hypothesis: LoopHypothesis, look: _Look, match: SubmapMatch, local_field: LocalField
    ) -> None:
        """Add a look to the support of a hypothesis; or link the places if nothing has to be corrected."""
        if hypothesis is self._estimate and _is_return(look, match):
            local_field.link(look.old, look.last)
            self._returns.append(look.travelled)
            self._estimate = LoopHypothesis(np.zeros(3))
        else:
            hypothesis.motion = look.motion(match.pose)
            hypothesis.support.append(look.loop_match(match))

    def _search(self, look: _Look) -> list[SubmapMatch]:
        """Return the poses at which a look fits within the uncertainty of the estimate."""
        found = search_submap(look.submap, look.reference, look.relative(np.zeros(3)), look.covariance)
        return [m for m in found if _fits(m) and _is_determined(m) and look.admits(m.pose)]

    def _accepted(self, looks: Sequence[_Look]) -> Agreement | None:
        """Return the hypothesis that enough looks support, that few contradict and that has no equal rival."""
        for hypothesis in (self._estimate, *self._hypotheses):
            count = len(hypothesis.support)
            if (
                count < MIN_SUPPORT
                or hypothesis.span < SUBMAP_LENGTH
                or hypothesis.support[-1].keyframe != looks[0].last
            ):
                continue
            first = hypothesis.support[0].travelled
            against = sum(at >= first for at in hypothesis.contradictions)
            others = [h for h in (self._estimate, *self._hypotheses) if h is not hypothesis]
            returns = sum(at >= first for at in self._returns)
            rival = max([returns, *(h.support_since(first) for h in others)])
            if hypothesis is not self._estimate and hypothesis.mean_fit < SEARCH_FIT:
                continue  # so well must a tracked scan fit: a place that fits worse may be a similar one
            admitted = hypothesis is self._estimate or looks[0].admits(looks[0].relative(hypothesis.motion))
            if admitted and count >= SUPPORT_RATIO * max(against, rival):
                doubted = min([first, *self._estimate.contradictions])
                return Agreement(
                    tuple(hypothesis.support), hypothesis.motion, rival / count, against, doubted - SUBMAP_LENGTH
                )
        return None


def _fits(match: SubmapMatch) -> bool:
    """True if a match shows enough of what the old place has seen, and that fits."""
    return match.known >= MIN_KNOWN and match.fit >= MIN_LOOP_FIT


def _is_determined(match: SubmapMatch) -> bool:
    """True if a match determines the position in every direction."""
    return bool(np.linalg.eigvalsh(match.covariance[:2, :2])[-1] < MAX_MATCH_SIGMA**2)


def _is_return(look: _Look, match: SubmapMatch) -> bool:
    """True if the estimate agrees with a match: the robot is back, and nothing has to be corrected."""
    error = se2.between(look.relative(np.zeros(3)), match.pose)
    return bool(error @ np.linalg.solve(match.covariance, error) < MAX_SQUARED_DISTANCE)


def _submap(mapper: Mapper, local_field: LocalField, keyframes: Integers, centre: int) -> Submap:
    """Build a submap of keyframes (n,) in the frame of one of them."""
    poses = se2.between(mapper.keyframe_poses[centre], mapper.keyframe_poses[keyframes]).reshape(-1, 3)
    return build_submap(poses, [local_field.points(int(k)) for k in keyframes], SUBMAP_HALF_WIDTH)


def _old_places(poses: Floats, travelled: Floats, inserted: Sequence[int], last: int) -> list[int]:
    """Return keyframes of earlier passes near the last keyframe: the oldest, and the nearest not in the field."""
    distances = np.hypot(*(poses[:, :2] - poses[last, :2]).T)
    distances[travelled > travelled[last] - 2 * SUBMAP_LENGTH] = np.inf
    near = np.flatnonzero(distances < REFERENCE_DISTANCE)
    places = []
    if len(near):
        oldest = near[travelled[near] < travelled[near[0]] + SUBMAP_LENGTH]
        places.append(int(oldest[distances[oldest].argmin()]))
    distances[list(inserted)] = np.inf
    nearest = int(distances.argmin())
    if distances[nearest] < MAX_SHIFT and nearest not in places:
        places.append(nearest)
    return places
