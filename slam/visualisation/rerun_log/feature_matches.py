"""Data association of one keyframe's features, prepared for drawing: matched, new, or gated out."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from drivers.immutable import immutable

from ...events import KeyframeAdded
from ...geometry.segments import Floats, Integers


@immutable
class FeatureMatches:
    """Association of n features of one kind.

    prefix       "L" for walls, "C" for corners
    landmark_id  (n,) associated landmark; -1: none
    distance     (n,) squared Mahalanobis distance to it, or to the nearest candidate; NaN without a candidate
    nearest      (n,) landmark id of the nearest candidate; -1: none
    new          (n,) True if the landmark was created from this feature
    """

    prefix: str
    landmark_id: Integers
    distance: Floats
    nearest: Integers
    new: NDArray[np.bool_]

    @classmethod
    def of_segments(cls, event: KeyframeAdded) -> FeatureMatches:
        """Return the association of the segments with walls."""
        new_walls = set(event.new_walls.tolist())  # `isin` takes ten times as long
        new = np.array([wall in new_walls for wall in event.wall_match.tolist()], dtype=bool)
        return cls("L", event.wall_match, event.wall_gate, event.wall_nearest, new)

    @classmethod
    def of_corners(cls, event: KeyframeAdded) -> FeatureMatches:
        """Return the association of the corners; an associated one that had no candidate is new."""
        new = (event.corner_match >= 0) & np.isnan(event.corner_gate)
        return cls("C", event.corner_match, event.corner_gate, event.corner_nearest, new)

    @property
    def matched(self) -> Integers:
        """(n,) id of the landmark that existed before and was matched; -1: none."""
        return np.where(self.new, -1, self.landmark_id)

    @property
    def gated_out(self) -> Integers:
        """(n,) id of the nearest landmark of features that were not associated; -1: none."""
        return np.where(self.landmark_id < 0, self.nearest, -1)

    def names(self) -> list[str]:
        """Return `L12`, `L12 new`, `none`, or `not L12` (a rejected candidate) for each feature."""
        names = []
        rows = zip(self.landmark_id.tolist(), self.nearest.tolist(), self.new.tolist(), strict=True)
        for landmark_id, nearest, new in rows:
            name = f"{self.prefix}{landmark_id} new" if new else f"{self.prefix}{landmark_id}"
            if landmark_id < 0:
                name = "none" if nearest < 0 else f"not {self.prefix}{nearest}"
            names.append(name)
        return names

    def distance_texts(self) -> list[str]:
        """Return the squared distances as text, empty for NaN."""
        return ["" if math.isnan(distance) else f"{distance:.1f}" for distance in self.distance.tolist()]

    def labels(self) -> list[str]:
        """Return `L12 d²=3.1` for each feature."""
        pairs = zip(self.names(), self.distance_texts(), strict=True)
        return [f"{name} d²={distance}" if distance else name for name, distance in pairs]
