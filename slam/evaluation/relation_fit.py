"""Check true motions by the scans: do the scans at both ends fit better along a path, or by the stated motion?

Relations of a benchmark were matched and confirmed by people, and some are wrong. Where an estimated path contradicts a
relation, the two scans show which of them is right: by the true motion, points of the second scan lie on the surfaces
that the first scan has seen. This needs neither a map nor any part of the estimator.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.spatial import cKDTree

from drivers import se2
from drivers.immutable import immutable
from drivers.messages import Scan

from ..errors import MapError
from ..geometry.segments import Floats
from ..io.tum import Trajectory
from ..preprocessing.deskew import sweep_middle
from .metrics import Relations, motion_errors

FIT_SIGMA = 0.03
"""Metres from a surface at which a point counts with 0.6. Origin: chosen, some times the noise of a lidar."""
MAX_RANGE = 8.0
"""Metres; farther points are not used: errors of the heading move them most. Origin: chosen, the size of a room."""
MAX_SURFACE_GAP = 0.25
"""Metres between neighbouring points of one surface. Origin: chosen, less than a door."""
SURFACE_STEP = 0.01
"""Metres between the places of a surface that points are compared with. Origin: definition, below FIT_SIGMA."""
MAX_TIME_DIFFERENCE = 0.002
"""Seconds between a relation's stamp and that of its scan. Origin: definition, files state milliseconds."""
LARGEST_SHARE = 0.1
"""Share of the relations, those with the largest errors, that are counted separately. Origin: definition."""


@immutable
class RelationFit:
    """How well two scans fit at n relations of which both scans are known.

    errors                (n,) metres between the motion of the path and the relation
    by_path, by_relation  (n,) fit of the second scan to the first, 0 to 1, by the motion of either
    """

    errors: Floats
    by_path: Floats
    by_relation: Floats

    def figures(self) -> dict[str, float]:
        """Return the shares of relations at which the scans fit better along the path: of all, and of the largest."""
        better = self.by_path > self.by_relation
        large = self.errors >= np.quantile(self.errors, 1.0 - LARGEST_SHARE)
        return {
            "compared": len(better),
            "path_fits_better": round(float(better.mean()), 4),
            "large_errors": int(large.sum()),
            "large_errors_from": round(float(self.errors[large].min()), 4),
            "path_fits_better_of_large": round(float(better[large].mean()), 4),
        }


def compare_fits(trajectory: Trajectory, relations: Relations, scans: Iterable[Scan]) -> RelationFit:
    """Return how well the scans of a recording fit along a trajectory and by relations.

    The stamp of a relation is that of a scan, or of the middle of its sweep: logs that state no times of the beams have
    that stamp. The motion of the robot within a sweep is neglected. Raises MapError if no relation has two scans.
    """
    kept = sorted(scans, key=lambda scan: scan.stamp)
    stamps, middles = np.array([scan.stamp for scan in kept]), np.array([sweep_middle(scan) for scan in kept])
    rows = []
    for times in (relations.first, relations.second):
        at_stamps = _rows_at(stamps, times)
        rows.append(np.where(at_stamps >= 0, at_stamps, _rows_at(middles, times)))
    start, end = trajectory.at(relations.first), trajectory.at(relations.second)
    known = start.covered & end.covered & (rows[0] >= 0) & (rows[1] >= 0)
    if not known.any():
        raise MapError("no relation has two scans in the recording: are both of the same drive?")
    motion, true = se2.between(start.poses[known], end.poses[known]).reshape(-1, 3), relations.motion[known]
    fits = [
        _fits(kept[first], kept[second], motions)
        for first, second, *motions in zip(rows[0][known], rows[1][known], motion, true, strict=True)
    ]
    by_path, by_relation = np.array(fits).T
    return RelationFit(motion_errors(motion, true).translation, by_path, by_relation)


def _rows_at(stamps: Floats, times: Floats) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return the rows (n,) of the scans with `stamps` (s,), ascending, at some times (n,), -1 where there is none."""
    if not len(stamps):
        return np.full(len(times), -1)
    rows = np.clip(np.searchsorted(stamps, times - MAX_TIME_DIFFERENCE), 0, len(stamps) - 1)
    return np.where(np.abs(stamps[rows] - times) <= MAX_TIME_DIFFERENCE, rows, -1)


def _fits(first: Scan, second: Scan, motions: Iterable[se2.Pose]) -> list[float]:
    """Return the fit of the second of two scans to the first one by each motion from the first to the second."""
    surface, points = _surface(_points(first)), _points(second)
    if not len(surface) or not len(points):
        return [0.0 for _ in motions]
    tree, fits = cKDTree(surface), []
    for motion in motions:
        distance, _ = tree.query(se2.transform(motion, points).reshape(-1, 2))
        fits.append(float(np.exp(-0.5 * (distance / FIT_SIGMA) ** 2).mean()))
    return fits


def _points(scan: Scan) -> Floats:
    """Return the points (p, 2) of a scan in the base's frame, in the order of the beams."""
    near = scan.ranges < min(MAX_RANGE, scan.range_max)  # false for NaN
    mount = np.zeros(3) if scan.mount is None else scan.mount
    bearings = scan.angles[near] + mount[2]
    return np.asarray(mount[:2] + scan.ranges[near, None] * np.column_stack([np.cos(bearings), np.sin(bearings)]))


def _surface(points: Floats) -> Floats:
    """Return points (p, 2) and places between neighbours of one surface, so that only the distance across counts."""
    steps = np.diff(points, axis=0)
    lengths = np.hypot(*steps.T)
    parts = [points]
    for row in np.flatnonzero((lengths > SURFACE_STEP) & (lengths < MAX_SURFACE_GAP)).tolist():
        count = int(lengths[row] / SURFACE_STEP)
        parts.append(points[row] + np.arange(1, count + 1)[:, None] / (count + 1) * steps[row])
    return np.concatenate(parts)
