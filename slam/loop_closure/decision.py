"""Decision on a loop closure candidate."""

from __future__ import annotations

from dataclasses import dataclass

from drivers import se2

from ..geometry.segments import Floats
from .loop_status import LoopStatus
from .proposal import Hypothesis
from .recent_walls import WallSet
from .verification import Verdict


@dataclass(frozen=True, slots=True, eq=False)
class LoopMatch:
    """Match of the keyframes up to `keyframe` with those around `old`.

    relative    [x, y, heading] of the keyframe in the frame of the old one
    covariance  (3, 3) in the keyframe's frame
    travelled   metres driven up to the keyframe
    fit, known  see `SubmapMatch`
    """

    keyframe: int
    old: int
    relative: se2.Pose
    covariance: Floats
    travelled: float
    fit: float
    known: float


@dataclass(frozen=True, slots=True, eq=False)
class LoopDecision:
    """Decision on a loop closure candidate, with the data that it rests on.

    candidate   running number
    keyframe    last keyframe when the decision was made
    old         keyframe that saw the place before
    motion      [x, y, heading] by which the robot would move, in its own frame
    verdict     result of the verification
    status      REJECTED, PENDING or CONFIRMED by the search; a confirmed one becomes ACCEPTED when it is closed, or
                REJECTED if the walls do not coincide then; RETRACTED if later scans contradict it
    hypothesis  motion of the recent walls onto the reference map
    pairs       landmark ids (old, recent) of walls that are the same wall by the hypothesis
    merged      those of the pairs that were merged
    shift       metres by which the last keyframe moved
    compared    recent walls and reference walls as they were when compared
    matches     matches of submaps that agree, if the candidate is not one of walls
    since       first keyframe of the pass that these matches move
    """

    candidate: int
    keyframe: int
    old: int
    motion: se2.Pose
    verdict: Verdict
    status: LoopStatus
    hypothesis: Hypothesis
    pairs: tuple[tuple[int, int], ...]
    merged: tuple[tuple[int, int], ...] = ()
    shift: float = 0.0
    compared: tuple[WallSet, WallSet] | None = None
    matches: tuple[LoopMatch, ...] = ()
    since: int = 0
