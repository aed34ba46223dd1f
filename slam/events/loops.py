"""Decisions on loop closures, with what they rest on and what they change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.immutable import immutable
from drivers.se2 import Pose

from ..geometry.segments import Floats
from ..loop_closure.loop_status import LoopStatus
from ..mapping.map_features import MapWalls


@dataclass(frozen=True, slots=True)
class LoopCheck:
    """One check of a loop hypothesis: `value` had to be at least (`at_least`) or at most the `gate`."""

    name: str
    value: float
    gate: float
    at_least: bool
    passed: bool


@immutable
class ComparedPoints:
    """Points of the last match of a loop hypothesis, in the map as it was then, metres.

    recent   (n, 2) points of the last keyframes
    aligned  (n, 2) the same, moved by the hypothesis
    old      (m, 2) points of the old place
    """

    recent: Floats
    aligned: Floats
    old: Floats


@immutable
class Correction:
    """Change of trajectory and map by a loop closure or a retraction.

    keyframe_poses_before  (k, 3) before
    keyframe_poses         (k, 3) after
    walls_before           walls before
    chi2_before            robust cost of the graph before
    chi2_strained          robust cost with the factors of the closure before anything moved; NaN for a retraction
    chi2                   robust cost after
    """

    keyframe_poses_before: Floats
    keyframe_poses: Floats
    walls_before: MapWalls
    chi2_before: float
    chi2_strained: float
    chi2: float

    def shifts(self) -> Floats:
        """Return the distance (k,) that each keyframe moved, metres."""
        return np.asarray(np.hypot(*(self.keyframe_poses - self.keyframe_poses_before)[:, :2].T))


@immutable
class LoopDecided:
    """Decision on a loop hypothesis after keyframe `index`.

    A retraction is published later than the closure at that keyframe, and a rejection when the hypothesis is given up,
    40 m of driving after the last look that supports it, or at the end of the run.

    candidate      running number
    old            keyframe that saw the place before
    motion         (3,) [x, y, heading] by which the robot would move, in its own frame
    status         accepted, rejected (a check fails, or the map does not fit together), or retracted (contradicted by
                   later scans)
    reason         reason of the status
    overlap_ratio  share of the recent points in space seen before that fit the old place
    matches        number of looks that support the hypothesis
    runner_up      number of looks that support the strongest rival, as a share of these
    sigma          standard deviation of the motion in its least certain direction, metres
    contradicted   share of the looks that contradict the hypothesis
    merged         pairs of wall ids (old, recent) that were merged
    shift          distance that the keyframe moved, metres
    margin         share of its requirement that the worst check meets, at most 1
    checks         all checks
    compared       points of the last match
    correction     change of trajectory and map, if the status is accepted or retracted
    """

    index: int
    stamp: float
    candidate: int
    old: int
    motion: Pose
    status: LoopStatus
    reason: str
    overlap_ratio: float
    matches: int
    runner_up: float
    sigma: float
    contradicted: float
    merged: tuple[tuple[int, int], ...]
    shift: float
    margin: float = 1.0
    checks: tuple[LoopCheck, ...] = ()
    compared: ComparedPoints | None = None
    correction: Correction | None = None
