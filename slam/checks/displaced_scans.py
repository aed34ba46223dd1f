"""Compare each scan with the map of the other scans: scans in a row that fit it better elsewhere are displaced.

Scans that were taken shortly before or after are left out of this map, as they may be displaced together. So it shows
only what was seen from elsewhere or on another pass; points in space that was not seen then say nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ..geometry.segments import Floats, Integers
from ..matching.point_matcher import POINT_SPACING
from ..matching.scan_points import surface_points
from ..preprocessing.preprocessor import NO_FEATURES
from .distance_rings import compared_points
from .drive import MIN_POINTS, Drive
from .leave_out_map import LeaveOutMap, Surroundings
from .passes import MAX_RANGE, MIN_SCANS
from .pose_search import search_pose
from .row_groups import MAX_GAP, consecutive_groups
from .step_checks import MIN_DISPLACEMENT, as_text, displacement
from .steps import FALSE_ALARM_PROBABILITY, FIELD_SCANS, FIT_WEIGHT, MAX_SEARCH
from .suspect import MAP, Suspect


@immutable
class Refits:
    """How much better n scans fit the map of the other scans elsewhere; filled in scan by scan.

    threshold     gain above which a scan is suspicious: ln(n / FALSE_ALARM_PROBABILITY)
    gain          (n,) logarithm of the likelihood there relative to that where the scan was placed; zero if no pose
                  can be better by the threshold
    motion        (n, 3) from where the scan was placed to there
    displacement  (n,) metres (RMS) between its points here and there
    """

    threshold: float
    gain: Floats
    motion: Floats
    displacement: Floats


def displaced_scans(drive: Drive) -> Iterator[Suspect]:
    """Yield the intervals of a sampled drive in which the scans fit the map of the others better elsewhere."""
    found = refit_scans(drive)
    for group in displaced_groups(found):
        worst = int(group[np.argmax(found.gain[group])])
        text = (
            f"the map does not fit together: {len(group)} scans fit the map of the others better elsewhere, this one "
            f"{as_text(found.motion[worst])} from where it was placed"
        )
        first, last = float(drive.stamps[group[0]]), float(drive.stamps[group[-1]])
        weight = float(found.gain[worst]) / found.threshold
        yield Suspect(MAP, float(drive.stamps[worst]), first, last, drive.poses[worst, :2], weight, text)


def displaced_groups(found: Refits) -> list[Integers]:
    """Return the rows of the scans of each interval in which enough of them fit better elsewhere."""
    suspicious = np.flatnonzero((found.gain > found.threshold) & (found.displacement > MIN_DISPLACEMENT))
    return [group for group in consecutive_groups(suspicious, MAX_GAP) if len(group) >= MIN_SCANS]


def refit_scans(drive: Drive) -> Refits:
    """Search a better pose around that of each scan of a sampled drive, by the map of the scans not near to it."""
    count = len(drive)
    found = Refits(
        math.log(max(count, 1) / FALSE_ALARM_PROBABILITY), np.zeros(count), np.zeros((count, 3)), np.zeros(count)
    )
    for row, points, around in _each_scan(drive):
        _refit(found, row, around, points, drive.poses[row])
    return found


def map_gain(drive: Drive, corrected: Drive) -> float:
    """Return how much more likely the scans of a sampled drive are, each in the map of the others, if it is corrected.

    The logarithm of the ratio. `corrected` has the same scans with other poses. A point that one of both maps cannot
    judge does not count.
    """
    gain = 0.0
    for (row, points, before), (_, _, after) in zip(_each_scan(drive), _each_scan(corrected), strict=True):
        gains = after.likelihoods(points, corrected.poses[row]) - before.likelihoods(points, drive.poses[row])
        gain += FIT_WEIGHT * float(np.nansum(gains)) / len(points)
    return gain


def _each_scan(drive: Drive) -> Iterator[tuple[int, Floats, Surroundings]]:
    """Yield the row of each scan that is compared, its points (p, 6), and the map of the scans not near to it."""
    count, points = len(drive), [_points(own) for own in drive.points]
    others = LeaveOutMap(drive.poses[:, :2])
    # The scans that are left out move along the drive: those up to FIELD_SCANS before and after the present one.
    for row in range(FIELD_SCANS, count):
        others.add(points[row], drive.poses[row])
    for row in range(count):
        if row + FIELD_SCANS < count:
            others.leave_out(points[row + FIELD_SCANS], drive.poses[row + FIELD_SCANS])
        if row > FIELD_SCANS:
            others.add(points[row - FIELD_SCANS - 1], drive.poses[row - FIELD_SCANS - 1])
        if len(points[row]) >= MIN_POINTS:
            yield row, points[row], others.around(drive.poses[row, :2], MAX_RANGE + math.hypot(*MAX_SEARCH[:2]))


def _points(points: Floats) -> Floats:
    """Return the points (q, 6) of a scan that are compared, with normals from their neighbours alone."""
    near = points[np.hypot(points[:, 0], points[:, 1]) <= MAX_RANGE]
    return compared_points(surface_points(near, NO_FEATURES.segments, POINT_SPACING))


def _refit(found: Refits, row: int, around: Surroundings, points: Floats, pose: se2.Pose) -> None:
    """Fill in what is found for a scan with `points` (p, 6) that was placed at `pose`."""
    here = around.likelihoods(points, pose)
    if FIT_WEIGHT * np.nansum(1.0 - here) / len(points) <= found.threshold:
        return  # no pose can be that much better
    there = search_pose(lambda poses: around.gains(points, here, poses), pose, MAX_SEARCH)
    gains = around.likelihoods(points, there) - here  # also of points behind what is at rest, which `gains` leaves out
    found.gain[row] = FIT_WEIGHT * np.nansum(gains) / len(points)
    found.motion[row] = se2.between(pose, there)
    found.displacement[row] = displacement(points[:, :2], pose, there)
