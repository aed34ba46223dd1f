"""Path distances between keyframes, along the drive and along links: over short ones, relative poses are well known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import compiled
from drivers.immutable import immutable

from ..geometry.membership import is_among
from ..geometry.segments import Floats, Integers
from ..geometry.surroundings import CORRIDOR_LENGTH

# Metres between keyframes along the drive, or along links between keyframes that saw the same place, up to which their
# relative pose is well known. Origin: definition, errors of odometry are common to that length.
MAX_PATH = CORRIDOR_LENGTH
# Metres; smaller differences between two paths are rounding errors. Origin: numerical.
ROUNDING = 1e-9


@immutable
class PathDistances:
    """Path distances between k keyframes: the lengths of the shortest paths along the drive and along links.

    driven  (k,) metres driven up to each, with what is undetermined of the motion
    links   (l, 2) pairs that saw the same place
    """

    driven: Floats
    links: Integers

    @classmethod
    def along(
        cls, travelled: Sequence[float], gaps: Mapping[int, float], links: Sequence[tuple[int, int]]
    ) -> PathDistances:
        """Return the path distances between keyframes.

        travelled  metres driven up to each keyframe
        gaps       metres by which the path to a keyframe counts as longer, by keyframe
        links      pairs of keyframes that saw the same place
        """
        longer = np.zeros(len(travelled))
        longer[list(gaps)] = list(gaps.values())
        driven = np.asarray(travelled, dtype=np.float64) + np.cumsum(longer)
        return cls(driven, np.array(links, dtype=np.int64).reshape(-1, 2))

    def first_since(self, distance: float) -> int:
        """Return the first keyframe within a distance (metres) of the last one along the drive."""
        return int(np.searchsorted(self.driven, self.driven[-1] - distance))

    def around(self, keyframe: int, distance: float) -> Integers:
        """Return the keyframes within a distance (metres) of one along the drive."""
        return np.flatnonzero(np.abs(self.driven - self.driven[keyframe]) < distance)

    def near(self, keyframes: Integers | Sequence[int]) -> Integers:
        """Return the keyframes within MAX_PATH of some, along the drive and the links, in ascending order."""
        return np.flatnonzero(self._to(keyframes) < MAX_PATH)

    def are_nearer(self, keyframes: Integers | Sequence[int], others: Integers | Sequence[int]) -> NDArray[np.bool_]:
        """Return (k,) which keyframes have a shorter path to one of some keyframes than to one of some others."""
        return np.asarray(self._to(keyframes) < self._to(others))

    def _to(self, keyframes: Integers | Sequence[int]) -> Floats:
        """Return (k,) the path distance of each keyframe to the nearest one of some."""
        distance = np.full(len(self.driven), np.inf)
        distance[keyframes] = 0.0
        _shorten(distance, self.driven, self.links)
        return distance

    def divide(self, keyframes: Integers | Sequence[int]) -> list[Integers]:
        """Divide keyframes, in ascending order, into groups between which no path is shorter than MAX_PATH.

        Each group is in ascending order, and so are the first keyframes of the groups.
        """
        keyframes = np.asarray(keyframes, dtype=np.int64)
        if not len(keyframes):
            return []
        begins = np.flatnonzero(np.diff(self.driven[keyframes]) >= MAX_PATH) + 1
        groups: list[Integers] = []
        for stretch in np.split(keyframes, begins):
            near = self.near(stretch) if len(begins) else stretch
            within = [bool(is_among(group, near).any()) for group in groups]
            joined = [group for group, is_within in zip(groups, within, strict=True) if is_within]
            groups = [group for group, is_within in zip(groups, within, strict=True) if not is_within]
            groups.append(np.sort(np.concatenate([*joined, stretch])))
        return sorted(groups, key=lambda group: int(group[0]))


@compiled
def _shorten(distance, driven, links):  # type: ignore[no-untyped-def]
    """Replace distances (k,) to keyframes, infinite if not known, by those along the drive and along links.

    driven  (k,) metres driven up to each keyframe
    links   (l, 2) pairs of keyframes at the same place
    """
    shorter = True
    while shorter:
        before = distance.copy()
        forward, backward = np.inf, np.inf
        for k in range(len(distance)):
            forward = min(forward, before[k] - driven[k])
            distance[k] = min(distance[k], forward + driven[k])
        for k in range(len(distance) - 1, -1, -1):
            backward = min(backward, before[k] + driven[k])
            distance[k] = min(distance[k], backward - driven[k])
        for one, other in links:
            distance[one] = distance[other] = min(distance[one], distance[other])
        shorter = False
        for k in range(len(distance)):
            shorter = shorter or distance[k] < before[k] - ROUNDING
