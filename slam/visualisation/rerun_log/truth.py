"""The true path, where a recording knows it, laid over the estimate."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np

from drivers import se2

KEPT = 20_000  # true poses; half of them outlast any delay of a keyframe
LONGEST_GAP = 1.0  # seconds between true poses that are interpolated


@dataclass(frozen=True, slots=True)
class TruthError:
    """How far keyframe `index` was from the truth when it was added: metres and radians."""

    index: int
    stamp: float
    position: float
    heading: float


class TruthComparison:
    """True poses and keyframes, brought together by their stamps in whatever order they come.

    The world's frame is aligned with the map's at the first keyframe whose true pose is known. That puts the whole
    error of that keyframe into the alignment, as anyone would who starts at a known place.
    """

    def __init__(self) -> None:
        self.alignment: se2.Pose | None = None  # T_map_world
        self._stamps: list[float] = []
        self._poses: list[se2.Pose] = []
        self._waiting: list[tuple[int, float, se2.Pose]] = []

    def add_truth(self, stamp: float, pose: se2.Pose) -> None:
        """A true pose, in the world's frame; one that is not later than the last is ignored."""
        if not self._stamps or stamp > self._stamps[-1]:
            self._stamps.append(stamp)
            self._poses.append(pose)

    def add_keyframe(self, index: int, stamp: float, pose: se2.Pose) -> None:
        """An estimated pose in the map's frame."""
        if self._stamps:
            self._waiting.append((index, stamp, pose))

    def in_map(self, pose: se2.Pose) -> se2.Pose:
        """A pose of the world in the map's frame. There must be an alignment."""
        assert self.alignment is not None
        return se2.compose(self.alignment, pose)

    def errors(self) -> list[TruthError]:
        """What can be compared now and was not before: keyframes that the truth has reached."""
        found: list[TruthError] = []
        while self._waiting and self._waiting[0][1] <= self._stamps[-1]:
            index, stamp, pose = self._waiting.pop(0)
            truth = self._at(stamp)
            if truth is None:
                continue
            if self.alignment is None:
                self.alignment = se2.compose(pose, se2.inverse(truth))
            off = se2.between(self.in_map(truth), pose)
            found.append(TruthError(index, stamp, float(np.hypot(off[0], off[1])), abs(float(off[2]))))
        self._forget()
        return found

    def _forget(self) -> None:
        """Drop true poses that no keyframe can ask for any more, now and then."""
        if not self._waiting and len(self._stamps) > KEPT:
            del self._stamps[: -KEPT // 2], self._poses[: -KEPT // 2]

    def _at(self, stamp: float) -> se2.Pose | None:
        """The true pose at a stamp that is not after the last one; None before the first and in gaps."""
        after = bisect_left(self._stamps, stamp)
        if self._stamps[after] == stamp:
            return self._poses[after]
        if after == 0 or self._stamps[after] - self._stamps[after - 1] > LONGEST_GAP:
            return None
        share = (stamp - self._stamps[after - 1]) / (self._stamps[after] - self._stamps[after - 1])
        motion = se2.between(self._poses[after - 1], self._poses[after])
        return se2.compose(self._poses[after - 1], share * motion)
