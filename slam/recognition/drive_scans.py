"""Submaps of the drive since the robot lost its pose, or since the run began, as input of the search for its place."""

from __future__ import annotations

import numpy as np

from ..geometry.segments import Floats
from ..localisation.local_field import LocalField
from ..loop_closure.submap_search import SUBMAP_LENGTH
from ..mapping.mapper import Mapper
from .map_descriptor import describe_map, express_in_frame
from .scanned_map import ScannedDrive, SubmapScan, scan_drive, scan_submap

# Submaps that are searched for. Origin: measured, of 90 searches in worlds of equal places, those that were decided had
# driven 21 m at most.
MAX_SUBMAPS = 4
# Keyframes between two searches, the same as a share of those of the drive so far, as a longer one takes more time to
# search for, and metres at most, so that each place is in two drives. A robot that turns on the spot has new keyframes,
# too. Origin: chosen; not measured.
SEARCH_KEYFRAMES = 2
SEARCH_SHARE = 0.2  # Origin: as SEARCH_KEYFRAMES.
MAX_SEARCH_DISTANCE = 0.5 * MAX_SUBMAPS * SUBMAP_LENGTH  # Origin: as SEARCH_KEYFRAMES.


class DriveScans:
    """Submaps of SUBMAP_LENGTH metres each, consecutive and without overlap; the last one may be shorter.

    A submap is matched as a rigid body, so it also ends where a blind stretch cuts the path.
    """

    def __init__(self) -> None:
        self._complete: dict[range, SubmapScan] = {}  # by keyframes
        self._searched = 0  # keyframes at the last search

    def __deepcopy__(self, memo: dict[int, object]) -> DriveScans:
        """Return an independent copy; submaps are never changed and are shared."""
        other = DriveScans()
        other._complete, other._searched = dict(self._complete), self._searched
        return other

    def clear(self) -> None:
        """Discard all submaps: the map has been corrected."""
        self._complete = {}

    def is_due(self, mapper: Mapper, first: int) -> bool:
        """Return True if the drive since a keyframe shows so much more that it is worth a search."""
        count, before = mapper.keyframe_count, self._searched
        if not first < before <= count:
            return True
        if mapper.travelled[-1] - mapper.travelled[before - 1] >= MAX_SEARCH_DISTANCE:
            return True
        return count - before >= max(SEARCH_KEYFRAMES, SEARCH_SHARE * (count - first))

    def take(self, mapper: Mapper, local_field: LocalField, first: int) -> ScannedDrive:
        """Return the last submaps of the drive since a keyframe, to be searched for now."""
        self._searched = mapper.keyframe_count
        driven = local_field.path_distances(mapper.travelled).driven
        spans = _spans(driven, range(first, mapper.keyframe_count))[-MAX_SUBMAPS:]
        self._complete = {span: self._complete.get(span) or _scan(mapper, local_field, span) for span in spans[:-1]}
        return scan_drive(mapper, [*self._complete.values(), _scan(mapper, local_field, spans[-1])])


def scan_stretch(mapper: Mapper, local_field: LocalField, keyframes: range) -> ScannedDrive:
    """Return the submaps of some keyframes of a map in which all keyframes are connected."""
    driven = local_field.path_distances(mapper.travelled).driven
    return scan_drive(mapper, [_scan(mapper, local_field, span) for span in _spans(driven, keyframes)])


def _spans(driven: Floats, keyframes: range) -> list[range]:
    """Return the keyframes of each submap, given the metres (k,) driven up to all keyframes."""
    since = driven[keyframes.start : keyframes.stop] - driven[keyframes.start]
    number = np.floor(since / SUBMAP_LENGTH).astype(np.int64)
    starts = keyframes.start + np.flatnonzero(np.diff(number, prepend=-1))
    ends = [*starts[1:].tolist(), keyframes.stop]
    return [range(start, end) for start, end in zip(starts.tolist(), ends, strict=True)]


def _scan(mapper: Mapper, local_field: LocalField, keyframes: range) -> SubmapScan:
    """Build the submap of some keyframes, with the walls seen since the first of them."""
    numbers, rows = np.arange(mapper.keyframe_count), np.arange(keyframes.start, keyframes.stop)
    poses = mapper.keyframe_poses[rows]
    descriptor = describe_map(mapper.landmarks, mapper.roughness.variances, numbers >= keyframes.start)
    return scan_submap(keyframes, express_in_frame(poses[-1], descriptor), poses, local_field.points_of(rows))
