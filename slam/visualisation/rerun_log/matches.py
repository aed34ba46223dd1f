"""What became of the features of a keyframe: matched with the map, new in it, or neither."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...events import KeyframeAdded
from ...geometry.segments import Floats, Integers


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """n features of one kind.

    prefix    "L" for walls, "C" for corners
    identity  (n,) in the map; -1: none
    gate      (n,) squared Mahalanobis distance of the match, or of the nearest candidate; NaN where there was none
    nearest   (n,) identity of that candidate; -1: none
    new       (n,) whether the feature was the first to show what it is matched with
    """

    prefix: str
    identity: Integers
    gate: Floats
    nearest: Integers
    new: NDArray[np.bool_]

    @classmethod
    def of_lines(cls, event: KeyframeAdded) -> Matches:
        """Those of the segments."""
        new = np.isin(event.line_match, event.new_lines)
        return cls("L", event.line_match, event.line_gate, event.line_nearest, new)

    @classmethod
    def of_corners(cls, event: KeyframeAdded) -> Matches:
        """Those of the corners; one that has an identity but had no candidate is new."""
        new = (event.corner_match >= 0) & np.isnan(event.corner_gate)
        return cls("C", event.corner_match, event.corner_gate, event.corner_nearest, new)

    @property
    def matched(self) -> Integers:
        """(n,) what each feature was matched with; -1: with nothing that was known."""
        return np.where(self.new, -1, self.identity)

    @property
    def gated_out(self) -> Integers:
        """(n,) what each feature was close to and not matched with; -1: nothing."""
        return np.where(self.identity < 0, self.nearest, -1)

    def names(self) -> list[str]:
        """`L12`, `L12 new`, `none`, or `not L12` where there was a candidate that was not taken, for each feature."""
        names = []
        rows = zip(self.identity.tolist(), self.nearest.tolist(), self.new.tolist(), strict=True)
        for identity, nearest, new in rows:
            name = f"{self.prefix}{identity} new" if new else f"{self.prefix}{identity}"
            if identity < 0:
                name = "none" if nearest < 0 else f"not {self.prefix}{nearest}"
            names.append(name)
        return names

    def distances(self) -> list[str]:
        """The gate values as text, empty where there is none."""
        return ["" if math.isnan(gate) else f"{gate:.1f}" for gate in self.gate.tolist()]

    def labels(self) -> list[str]:
        """`L12 d²=3.1`, for each feature."""
        pairs = zip(self.names(), self.distances(), strict=True)
        return [f"{name} d²={distance}" if distance else name for name, distance in pairs]
