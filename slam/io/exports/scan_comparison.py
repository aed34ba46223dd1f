"""Compare the scans of a recording with those that a session keeps: another recording may have scans at their times."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...errors import MapError
from ...geometry.surroundings import SURFACE_DEPTH
from .scan_placement import PlacedScan

if TYPE_CHECKING:
    from ...geometry.segments import Floats


def checked_scans(
    scans: Iterable[PlacedScan], kept: Iterable[PlacedScan], session: Path, recording: str
) -> Iterator[PlacedScan]:
    """Yield the scans of a recording; raise MapError at the end if there are none, or other ones than were kept.

    kept                some scans of the session, placed on the same path
    session, recording  their names, for the error

    Scans at the same time are the same if most of the kept points are where points of the recording are.
    """
    by_stamp: dict[float, PlacedScan] = {}
    for scan in kept:
        by_stamp.setdefault(scan.stamp, scan)  # of the first lidar if there are two
    count = same = different = 0
    for scan in scans:
        count += 1
        before = by_stamp.pop(scan.stamp, None)
        if before is not None and len(before.points):
            is_same = _median_distance(before.points, scan.points) < SURFACE_DEPTH
            same, different = same + is_same, different + (not is_same)
        yield scan
    if not count:
        raise MapError(f"{session}: {recording} has no scan at the times of its path; is it another recording?")
    if different > same:
        raise MapError(f"{session}: its map was not made from the scans of {recording}")


def _median_distance(points: Floats, others: Floats) -> float:
    """Return the median distance of points (n, 2) from the nearest of others (m, 2), metres; inf without any."""
    if not len(others):
        return np.inf
    return float(np.median(np.linalg.norm(points[:, None] - others, axis=2).min(axis=1)))
