"""Next distance field around the robot, built in steps while the present one is still used.

Inserting the scans of some hundred keyframes at once would delay a scan by tens of milliseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.immutable import immutable

from ..geometry.membership import is_among
from ..geometry.segments import Floats, Integers
from ..matching.distance_field import DistanceField

# Keyframes that are inserted at a step. Origin: measured, they take 2 ms in buildings; fields of some hundred keyframes
# are complete after some metres of driving.
KEYFRAMES_PER_STEP = 50


@immutable
class FieldSuccessorState:
    """What a successor is rebuilt from, besides the points of the keyframes.

    centre     (2,) metres, middle of the field
    keyframes  to be inserted, in this order
    poses      (k, 3) at which the first k of them were inserted
    """

    centre: Floats
    keyframes: Sequence[int]
    poses: Floats


@dataclass(slots=True, eq=False)
class FieldSuccessor:
    """Field under construction.

    field      what was inserted so far
    keyframes  whose points are to be inserted, in this order
    poses      (k, 3) at which the first k of them were inserted
    """

    field: DistanceField
    keyframes: Integers
    poses: Floats

    @classmethod
    def around(cls, position: Floats, keyframes: Integers) -> FieldSuccessor:
        """Return an empty field around a position (2,), for the points of some keyframes."""
        return cls(DistanceField.empty(position), keyframes, np.zeros((0, 3)))

    @classmethod
    def restored(cls, state: FieldSuccessorState, points: Sequence[NDArray[np.float32]]) -> FieldSuccessor:
        """Restore a saved field; `points` are those of all keyframes."""
        keyframes = np.array(state.keyframes, dtype=np.int64)
        successor = cls(DistanceField.empty(state.centre), keyframes, state.poses)
        successor.field.insert_scans(state.poses, [points[k] for k in keyframes[: len(state.poses)].tolist()])
        return successor

    @property
    def state(self) -> FieldSuccessorState:
        """State to be saved."""
        return FieldSuccessorState(self.field.centre, tuple(self.keyframes.tolist()), self.poses)

    @property
    def complete(self) -> bool:
        """True if all keyframes are inserted."""
        return len(self.poses) == len(self.keyframes)

    def add(self, keyframes: Integers) -> None:
        """Add keyframes whose points are to be inserted as well, unless they are already among them."""
        self.keyframes = np.concatenate([self.keyframes, keyframes[~is_among(keyframes, self.keyframes)]])

    def step(self, poses: Floats, points: Sequence[NDArray[np.float32]]) -> None:
        """Insert the next KEYFRAMES_PER_STEP keyframes, given the poses (n, 3) and the points of all keyframes."""
        inserted = len(self.poses)
        following = self.keyframes[inserted : inserted + KEYFRAMES_PER_STEP]
        self.field.insert_scans(poses[following], [points[k] for k in following.tolist()])
        self.poses = np.concatenate([self.poses, poses[following]])
