"""How much the places of a map look like each other.

The evidence for a place is a comparison with places that look like it by chance; see `evidence`. In a building of equal
rooms, and of corridors with equal doors, places look alike because they were built so. A robot at one that is not
mapped fits the map nearly as well as at its own place, and nothing in the map tells that there is another one. But the
map tells how much the places of the building resemble each other: stretches of its own drives, as long as the drive
that is searched for, are searched for in the map without their own place. The mean of their likelihood ratios is taken
for that of a drive at a place that is not mapped.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..geometry.segments import Floats
from ..localisation.local_field import REFERENCE_DISTANCE, LocalField
from ..loop_closure.submap_search import SUBMAP_LENGTH
from ..mapping.mapper import Mapper
from .drive_scans import scan_stretch
from .evidence import chances_of_fit, compare_cells, evidence_of
from .placements import Placement, find_placements
from .scanned_map import ScannedDrive, ScannedMap

# Submaps of a map that are searched for in it. Origin: chosen, for time: one search in a large map takes tenths of a
# second. In a building of which one place in so many looks like another one, that place is among them.
SAMPLED_SUBMAPS = 16


# Metres of driving in whose multiples a stretch is as long as a drive, so that it is searched for once for several
# lengths of a drive. Origin: definition, half a submap.
LENGTH_STEP = 0.5 * SUBMAP_LENGTH


@dataclass(frozen=True, slots=True)
class SelfSimilarity:
    """Similarity of the places of the map of the keyframes `chosen` (k,) of a mapper.

    known      this map, prepared to be searched
    by_length  results by the length of a drive, in multiples of LENGTH_STEP; valid while the map does not change
    """

    mapper: Mapper
    local_field: LocalField
    chosen: NDArray[np.bool_]
    known: ScannedMap
    by_length: dict[int, float] = field(default_factory=dict)

    def of(self, drive: ScannedDrive) -> float:
        """Return the logarithm of the mean likelihood ratio of stretches as long as a drive, at wrong places.

        It is minus infinity if none of them fits elsewhere, or if the map has no stretch as long as the drive.
        """
        driven = self.local_field.path_distances(self.mapper.travelled).driven
        length = sum(float(np.ptp(driven[submap.scan.keyframes])) for submap in drive.submaps)
        steps = max(1, math.ceil(length / LENGTH_STEP))
        if steps not in self.by_length:
            stretches = self._stretches(driven, steps * LENGTH_STEP)
            evidence = [_evidence_elsewhere(stretch, self.known) for stretch in stretches]
            mean = float(np.logaddexp.reduce(evidence)) - math.log(len(evidence)) if evidence else -math.inf
            self.by_length[steps] = mean
        return self.by_length[steps]

    def _stretches(self, driven: Floats, length: float) -> Iterator[ScannedDrive]:
        """Yield stretches of some metres of the map, evenly distributed; `driven` (k,) metres up to all keyframes."""
        ends = np.searchsorted(driven, driven + length)  # first keyframe that is so far ahead
        starts = np.flatnonzero(ends < len(driven))
        apart = np.cumsum(~self.chosen)  # equal at both ends if all keyframes between them are chosen
        starts = starts[self.chosen[starts] & (apart[starts] == apart[ends[starts]])]
        count = round(SAMPLED_SUBMAPS / math.ceil(length / SUBMAP_LENGTH))
        for row in np.unique(np.linspace(0, len(starts) - 1, count).round().astype(np.int64)) if len(starts) else ():
            yield scan_stretch(self.mapper, self.local_field, range(int(starts[row]), int(ends[starts[row]]) + 1))


def _evidence_elsewhere(stretch: ScannedDrive, known: ScannedMap) -> float:
    """Return the logarithm of the likelihood ratio of all placements of a stretch away from its own place, nats."""
    placements = [one for one in find_placements(stretch, known, None) if _is_elsewhere(stretch, one)]
    fits = [compare_cells(stretch, known, placement) for placement in placements]
    pairs = zip(fits, chances_of_fit(fits), strict=True) if fits else ()
    return float(np.logaddexp.reduce([evidence_of(*pair) for pair in pairs] or [-np.inf]))


def _is_elsewhere(stretch: ScannedDrive, placement: Placement) -> bool:
    """Return True if a placement has no submap near the place where its own map has it."""
    own = np.array([submap.pose for submap in stretch.submaps])
    return bool(np.hypot(*(placement.poses - own)[:, :2].T).min() > REFERENCE_DISTANCE)
