"""Returns of stored scans, placed in the map with the beams that have measured them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2
from drivers.immutable import immutable
from drivers.messages import Odometry

from ...geometry.segments import Floats
from ...odometry.history import OdometryHistory
from ..tum import Trajectory
from .scan_placement import PlacedScan

if TYPE_CHECKING:
    from ..sessions import StoredSession


@immutable
class KeyframePoints:
    """Returns of a keyframe's scan in the base's frame, metres, as 32-bit floats.

    points  (n, 2)
    lidars  (k, 2) positions of the lidars
    """

    stamp: float
    points: np.ndarray[tuple[int, int], np.dtype[np.float32]]
    lidars: Floats

    @classmethod
    def within(cls, stamp: float, points: Floats, lidars: Floats, max_range: float = np.inf) -> KeyframePoints:
        """Return the points (n, 2) that are within `max_range` metres of a lidar."""
        near = points[_distances(points, lidars).min(axis=1) <= max_range]
        return cls(stamp, near.astype(np.float32), lidars.copy())

    def placed(self, pose: se2.Pose) -> Iterator[PlacedScan]:
        """Yield the scan of each lidar in the map, taken with the base at `pose`.

        If there are several lidars, a point counts as measured by the nearest one. This hardly matters, as they are
        close together.
        """
        points = np.asarray(self.points, dtype=np.float64)
        nearest = _distances(points, self.lidars).argmin(axis=1)
        for row, lidar in enumerate(self.lidars):
            own = points[nearest == row]
            yield PlacedScan(self.stamp, se2.transform(pose, lidar), se2.transform(pose, own))


def place_stored_scans(
    session: StoredSession, trajectory: Trajectory, lidars: Floats, max_count: int | None = None
) -> Iterator[PlacedScan]:
    """Yield the returns of the scans that a session keeps, on the finished `trajectory`, which has a pose at each scan.

    lidars     (k, 2) positions of the lidars on the base, if the session states none
    max_count  place at most as many scans, or few more, spread over the drive; by default all
    """
    path = OdometryHistory()
    for stamp, pose in zip(trajectory.stamps.tolist(), trajectory.poses, strict=True):
        path.add(Odometry(stamp, pose))
    rows = np.flatnonzero(session.scan_history().has_features).tolist()
    step = 1 if max_count is None else max(1, len(rows) // max_count)
    for row in rows[::step]:
        scan = session.scans[row]
        own = session.lidars_at(scan.stamp, lidars)
        yield from KeyframePoints.within(scan.stamp, scan.features.points.xy, own).placed(path.at(scan.stamp))


def _distances(points: Floats, lidars: Floats) -> Floats:
    """Return the distances (n, k) of points (n, 2) from lidars (k, 2)."""
    return np.asarray(np.linalg.norm(points[:, None] - lidars, axis=2))
