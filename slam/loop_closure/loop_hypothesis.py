"""Hypotheses of loop closure: motions of the robot in the map, with the looks at old places for and against each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from drivers import se2
from drivers.immutable import immutable

from ..geometry.segments import Floats, Integers
from .decision import LoopDecision, LoopMatch


@dataclass(slots=True, eq=False)
class LoopHypothesis:
    """Motion [x, y, heading] that would move the robot in the map, with the looks for and against it.

    support         latest match of each look that supports it; there is at least one
    contradictions  metres driven up to each look that contradicts it
    rejection       decision against it at the last look that supports it, for reports; not stored in sessions
    admitted        true unless the estimate's uncertainty excludes its closure at the last look that supports it
    """

    motion: se2.Pose
    support: list[LoopMatch] = field(default_factory=list)
    contradictions: list[float] = field(default_factory=list)
    rejection: LoopDecision | None = None
    admitted: bool = True

    @property
    def span(self) -> float:
        """Metres of driving between the first and the last look that support it."""
        return self.support[-1].travelled - self.support[0].travelled if self.support else 0.0

    def copy(self) -> LoopHypothesis:
        """Return an independent copy."""
        return replace(self, support=list(self.support), contradictions=list(self.contradictions))

    def support_since(self, travelled: float) -> int:
        """Return the number of looks that support it from a distance driven (metres) on."""
        return sum(match.travelled >= travelled for match in self.support)

    def discriminating_looks(self, rival: LoopHypothesis) -> int:
        """Return the number of looks that support it and contradict a rival."""
        return len({match.travelled for match in self.support} & set(rival.contradictions))

    def contradictions_since(self, travelled: float) -> int:
        """Return the number of looks that contradict it from a distance driven (metres) on."""
        return sum(at >= travelled for at in self.contradictions)


@immutable
class OldPlace:
    """Keyframes (k,) of a submap of an old place, and their poses (k, 3) in its frame."""

    keyframes: Integers
    poses: Floats


@immutable
class LoopAgreementState:
    """State of the search for agreement, as it is saved with a session.

    last_search     metres driven up to the last look
    places          submaps of the last old places, by the keyframe in their middle, in the order of building
    searched        metres driven up to the last search of each place, by the keyframe in its middle
    returned_at     metres driven up to each look that agrees with the estimate
    contradictions  metres driven up to each look that contradicts the estimate, since the last return
    hypotheses      with at least one look each that supports them
    candidates      number of decisions so far that were reported
    retracted       motions of retracted closures, which are not accepted again
    """

    last_search: float = 0.0
    places: Sequence[tuple[int, OldPlace]] = ()
    searched: Sequence[tuple[int, float]] = ()
    returned_at: Sequence[float] = ()
    contradictions: Sequence[float] = ()
    hypotheses: Sequence[LoopHypothesis] = ()
    candidates: int = 0
    retracted: Sequence[se2.Pose] = ()

    @property
    def keyframes(self) -> list[int]:
        """Numbers of all keyframes that it refers to."""
        matches = [match for hypothesis in self.hypotheses for match in hypothesis.support]
        of_places = [k for centre, place in self.places for k in (centre, *place.keyframes.tolist())]
        of_places += [keyframe for keyframe, _ in self.searched]
        return [*of_places, *(k for match in matches for k in (match.keyframe, match.old))]
