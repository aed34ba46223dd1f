"""Parts of a map: keyframes that were mapped from one loss of the pose to the next.

The poses of two parts relative to each other are known by odometry only, or not at all, until one is recognised in the
other. Then they are joined into one group. Until then, nothing in one part may be associated with anything in the
other, however near to each other they seem to be.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..geometry.segments import Integers


class MapParts:
    """Parts of consecutive keyframes, numbered from 0, and the groups in which they are joined.

    firsts    first keyframe of each part
    groups    for each part, the number of the oldest part with which it is joined; its own if there is none
    measured  for each part, true if odometry measured the motion to it from the part before
    """

    def __init__(
        self, firsts: Sequence[int] = (0,), groups: Sequence[int] = (0,), measured: Sequence[bool] = (True,)
    ) -> None:
        self.firsts, self.groups, self.measured = list(firsts), list(groups), list(measured)

    def __len__(self) -> int:
        return len(self.firsts)

    def followed_by(self, other: MapParts, keyframe: int) -> MapParts:
        """Return the parts of two maps that are connected; the other one's keyframes follow from `keyframe` on."""
        if not self.apart and not other.apart:
            return MapParts()
        return MapParts(
            [*self.firsts, *(first + keyframe for first in other.firsts)],
            [*self.groups, *(group and group + len(self) for group in other.groups)],
            [*self.measured, False, *other.measured[1:]],
        )

    def begin(self, keyframe: int, *, measured: bool) -> None:
        """Begin a part with a keyframe, which is not connected with any other."""
        if keyframe == self.firsts[-1]:  # nothing was mapped since the last part began
            self.measured[-1] = self.measured[-1] and measured
            return
        self.firsts.append(keyframe)
        self.groups.append(len(self.groups))
        self.measured.append(measured)

    def drop_last(self) -> None:
        """Drop the last part, in which nothing was mapped."""
        del self.firsts[-1], self.groups[-1], self.measured[-1]

    def join(self, keyframe: int, other: int) -> None:
        """Join the groups of two keyframes."""
        one, two = sorted((self.group(keyframe), self.group(other)))
        self.groups = [one if group == two else group for group in self.groups]

    def separate(self, part: int) -> None:
        """Separate the parts from a number on from earlier ones; they stay joined among themselves."""
        first = {self.groups[k]: k for k in reversed(range(part, len(self)))}
        self.groups[part:] = [group if group >= part else first[group] for group in self.groups[part:]]

    def part(self, keyframe: int) -> int:
        """Return the number of the part of a keyframe."""
        return int(np.searchsorted(np.array(self.firsts), keyframe, side="right")) - 1

    def group(self, keyframe: int) -> int:
        """Return the number of the group of a keyframe."""
        return int(self.groups_of(np.array([keyframe]))[0])

    def groups_of(self, keyframes: Integers) -> Integers:
        """Return the numbers (n,) of the groups of keyframes (n,)."""
        parts = np.searchsorted(np.array(self.firsts), keyframes, side="right") - 1
        return np.array(self.groups)[np.maximum(parts, 0)]

    def connected(self, keyframes: Integers, keyframe: int | None = None) -> NDArray[np.bool_]:
        """Return (n,) which keyframes are in the group of another one, that of the last part if `keyframe` is None."""
        if len(self.firsts) == 1:
            return np.ones(np.shape(keyframes), dtype=bool)
        return np.asarray(self.groups_of(keyframes) == (self.groups[-1] if keyframe is None else self.group(keyframe)))

    def reachable(self, keyframes: Integers) -> NDArray[np.bool_]:
        """Return (n,) from which keyframes joins and measured motions lead to the last part."""
        if len(self.firsts) == 1:
            return np.ones(np.shape(keyframes), dtype=bool)
        roots = list(self.groups)
        for part in range(1, len(self.firsts)):
            if self.measured[part]:
                before, after = roots[part - 1], roots[part]
                roots = [before if root == after else root for root in roots]
        same = np.array([root == roots[-1] for root in roots])
        return np.asarray(same[self.groups_of(keyframes)])

    @property
    def current_is_apart(self) -> bool:
        """True if the last part is not connected with the first one."""
        return self.groups[-1] > 0

    def current_is_largest(self, keyframes: int) -> bool:
        """Return True if the group of the last part has more keyframes than any other, of `keyframes` in the map."""
        sizes = np.zeros(len(self), dtype=np.int64)
        np.add.at(sizes, self.groups, np.diff([*self.firsts, keyframes]))
        return int(sizes.argmax()) == self.groups[-1]  # of equal ones, the first

    @property
    def current_first(self) -> int:
        """First keyframe of the group of the last part."""
        return self.firsts[self.groups[-1]]

    @property
    def last_run_first(self) -> int:
        """First keyframe of the last parts in a row that are in the group of the last part."""
        others = [part for part in range(len(self)) if self.groups[part] != self.groups[-1]]
        return self.firsts[others[-1] + 1] if others else 0

    @property
    def apart(self) -> list[int]:
        """Numbers of the groups that are not connected with the first part."""
        return sorted({group for group in self.groups if group})
