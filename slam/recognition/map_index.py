"""Map index: the walls of a map prepared for a search from any start.

Pairs of walls of a submap vote for its pose in the whole map, and the poses with most votes are aligned on all walls.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.immutable import immutable

from ..geometry.segments import Floats
from ..loop_closure.submap_search import DISTINCT_SHIFT, DISTINCT_TURN
from ..mapping.mapper import Mapper
from .map_descriptor import MapDescriptor, describe_map
from .submap_alignment import Alignment, align_submap, sample_walls
from .wall_pairs import build_pair_table, vote_for_poses

# Poses of a submap with most votes that are aligned, and placements of a drive that are compared, those first in which
# most wall length lies on walls. Origin: chosen, for speed; not measured.
MAX_CANDIDATES = 64
# Walls of a submap and of a map. Origin: definition, three determine a pose and leave one that can contradict it.
MIN_WALLS = 3


@immutable
class MapIndex:
    """Map prepared for a search from any start: its descriptor and pair table. Not updated when the map changes."""

    descriptor: MapDescriptor
    pairs: Floats


def index_map(mapper: Mapper, observers: NDArray[np.bool_] | None = None) -> MapIndex:
    """Prepare a map. Takes a few milliseconds per hundred walls.

    With `observers` (k,), only of walls that one of these keyframes saw last.
    """
    descriptor = describe_map(mapper.landmarks, mapper.roughness.variances, observers)
    return MapIndex(descriptor, build_pair_table(descriptor))


def align_candidates(observed: MapDescriptor, index: MapIndex) -> list[Alignment]:
    """Return the distinct alignments of a submap with a map that have most votes, most wall length first."""
    if len(observed) < MIN_WALLS or len(index.descriptor) < MIN_WALLS:
        return []
    samples = sample_walls(observed)
    starts = vote_for_poses(observed, index.pairs, MAX_CANDIDATES)
    return _select_distinct([align_submap(start, observed, samples, index.descriptor) for start in starts])


def _select_distinct(aligned: Sequence[Alignment]) -> list[Alignment]:
    """Return the alignment with most wall length at each distinct pose, most wall length first."""
    remaining = sorted(aligned, key=lambda alignment: -alignment.length)
    selected: list[Alignment] = []
    while remaining:
        selected.append(remaining[0])
        distinct = _are_distinct(remaining[0].pose, np.array([alignment.pose for alignment in remaining]))
        remaining = [alignment for alignment, other in zip(remaining, distinct, strict=True) if other]
    return selected


def _are_distinct(pose: se2.Pose, poses: Floats) -> NDArray[np.bool_]:
    """Return (n,) which of the poses (n, 3) are distinct places from `pose`."""
    difference = se2.between(pose, poses)
    far = np.hypot(difference[:, 0], difference[:, 1]) > DISTINCT_SHIFT
    return np.asarray(far | (np.abs(difference[:, 2]) > DISTINCT_TURN))
