"""Decision on a loop closure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers import se2
from drivers.immutable import immutable

from ..geometry.pose_covariance import position_sigma
from ..geometry.segments import Floats
from .loop_status import LoopStatus


@immutable
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


@dataclass(frozen=True, slots=True)
class Check:
    """Check of a hypothesis: a measured value and its gate, the least value if `at_least`, else the largest."""

    name: str
    value: float
    gate: float
    at_least: bool

    @property
    def passed(self) -> bool:
        """True if the value keeps the gate."""
        return self.value >= self.gate if self.at_least else self.value <= self.gate

    @property
    def margin(self) -> float:
        """Share of the requirement that is met; below 1 if the check fails."""
        reached, required = (self.value, self.gate) if self.at_least else (self.gate, self.value)
        return reached / required if required > 0.0 else math.inf


@immutable
class LoopDecision:
    """Decision on closing a loop, with the data that it rests on.

    candidate     running number
    keyframe      last keyframe when the decision was made
    old           keyframe that saw the place before
    motion        [x, y, heading] by which the robot would move, in its own frame
    correction    the same motion of the recent keyframes, in the map
    status        CONFIRMED by the search, or REJECTED if a check fails that evidence cannot replace; a confirmed one
                  becomes ACCEPTED when the loop is closed, or REJECTED if the evidence of the drive is against it or if
                  the map does not fit together then; RETRACTED if later scans contradict it
    reason        reason of the status
    matches       of submaps, which agree
    runner_up     looks that support the strongest rival, as a share
    contradicted  share of the looks that contradict it
    checks        all checks; once the evidence has confirmed the closure, without failed ones that it replaces
    since         first keyframe of the pass that is moved
    compared      points (n, 2) of the recent submap, in the map before the closure, and (m, 2) of the old place
    merged        landmark ids (old, recent) of walls that were merged
    shift         metres by which the last keyframe moved
    joins         true if it joins parts of the map that were not connected
    doubted       true if the errors of the estimate were taken as correlated along the drive, see `RelativeUncertainty`
    """

    candidate: int
    keyframe: int
    old: int
    motion: se2.Pose
    correction: se2.Pose
    status: LoopStatus
    reason: str
    matches: tuple[LoopMatch, ...]
    runner_up: float
    contradicted: float
    checks: tuple[Check, ...]
    since: int
    compared: tuple[Floats, Floats]
    merged: tuple[tuple[int, int], ...] = ()
    shift: float = 0.0
    joins: bool = False
    doubted: bool = False

    @property
    def fit(self) -> float:
        """Share of the last submap's points in seen space that fit."""
        return self.matches[-1].fit

    @property
    def margin(self) -> float:
        """Share of its requirement that the worst check meets, at most 1."""
        return min((1.0, *(check.margin for check in self.checks)))

    @property
    def sigma(self) -> float:
        """Standard deviation of the last match in its least certain direction, metres."""
        return position_sigma(self.matches[-1].covariance)
