"""The driven trajectory: scan poses relative to keyframes, and odometry interpolated between the scans."""

from __future__ import annotations

from array import array

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.immutable import immutable

from ..geometry.growing_array import GrowingArray
from ..geometry.segments import Floats
from ..odometry.history import BLOCK, OdometryHistory

# Seconds below which two stamps are one, and by which scans are at least apart: files state microseconds.
# Origin: definition.
SAME_STAMP = 1e-6


class TrajectoryBuilder:
    """Poses of the scans relative to their keyframes, so that they follow when the map is corrected."""

    def __init__(self) -> None:
        self._stamps, self._keyframes = GrowingArray(()), array("q")
        self._relative, self._informations = GrowingArray((3,)), GrowingArray((3, 3))

    @classmethod
    def from_arrays(
        cls, stamps: Floats, keyframes: NDArray[np.int64], relative: Floats, informations: Floats
    ) -> TrajectoryBuilder:
        """Build a trajectory from what `relative_poses` returns."""
        trajectory = cls()
        trajectory._stamps.replace(stamps)
        trajectory._keyframes = array("q", keyframes)
        trajectory._relative.replace(relative)
        trajectory._informations.replace(informations)
        return trajectory

    def __deepcopy__(self, memo: dict[int, object]) -> TrajectoryBuilder:
        """Return an independent copy."""
        other = TrajectoryBuilder()
        other._stamps, other._keyframes = self._stamps.copy(), self._keyframes[:]
        other._relative, other._informations = self._relative.copy(), self._informations.copy()
        return other

    def __len__(self) -> int:
        return len(self._stamps)

    def add(self, stamp: float, keyframe: int, relative: se2.Pose, information: Floats) -> None:
        """Add a scan: its pose relative to a keyframe, and the information (3, 3) of its registration, in its frame."""
        self._stamps.append(stamp)
        self._keyframes.append(keyframe)
        self._relative.append(relative)
        self._informations.append(information)

    def relative_poses(self) -> tuple[Floats, NDArray[np.int64], Floats, Floats]:
        """Return for each scan its stamp (n,), its keyframe (n,), its pose relative to it (n, 3), and its information.

        The informations are (n, 3, 3), each in the scan's own frame. None of these is to be changed.
        """
        keyframes = np.array(self._keyframes, dtype=np.int64)
        return self._stamps.rows, keyframes, self._relative.rows, self._informations.rows

    def at_scans(self, keyframe_poses: Floats) -> tuple[Floats, Floats]:
        """Return stamps (n,) and poses (n, 3) of the scans in the map, given the keyframes' poses (k, 3)."""
        keyframes = np.array(self._keyframes, dtype=np.int64)
        return self._stamps.rows, se2.compose(keyframe_poses[keyframes], self._relative.rows).reshape(-1, 3)

    def clip(self, begin: float, end: float) -> TrajectoryBuilder:
        """Return the part with stamps in [begin, end) seconds."""
        stamps, keyframes = self._stamps.rows, np.array(self._keyframes, dtype=np.int64)
        rows = (stamps >= begin) & (stamps < end)
        relative, informations = self._relative.rows[rows], self._informations.rows[rows]
        return TrajectoryBuilder.from_arrays(stamps[rows], keyframes[rows], relative, informations)

    def path(self, keyframe_poses: Floats, odometry: OdometryHistory) -> tuple[Floats, Floats]:
        """Return stamps (m,) and poses (m, 3) in the map at every odometry reading and scan; empty without any scan.

        The scans are included because their poses are known best. Between readings the robot may change its speed, so
        interpolation does not return them.

        Each reading is reached by odometry from the scan before it. The error of odometry up to the next scan is
        distributed in proportion to the wheel travel between the two scans: wheels err while they roll, not while they
        stand. If they stand all the time, it is distributed evenly: the robot is carried, or odometry is failing.
        """
        stamps, poses = self.at_scans(keyframe_poses)
        if not len(stamps):
            return np.zeros(0), np.zeros((0, 3))
        known, travelled = odometry.stamps, odometry.travelled
        scans = _Scans(stamps, poses, odometry.at_each(stamps), np.interp(stamps, known, travelled))
        at = _united(known, stamps)
        result = np.empty((len(at), 3))
        for begin in range(0, len(at), BLOCK):
            some = at[begin : begin + BLOCK]
            result[begin : begin + BLOCK] = scans.between(
                some, odometry.at_each(some), np.interp(some, known, travelled)
            )
        return at, result


@immutable
class _Scans:
    """n scans of a trajectory in one odometry segment.

    stamps     (n,) seconds
    poses      (n, 3) in the map
    odometry   (n, 3) odometry poses
    travelled  (n,) metres of wheel travel up to each
    """

    stamps: Floats
    poses: Floats
    odometry: Floats
    travelled: Floats

    def between(self, at: Floats, readings: Floats, travelled: Floats) -> Floats:
        """Return poses (m, 3) in the map at stamps (m,), from odometry poses and wheel travel then.

        For the method see `TrajectoryBuilder.path`.
        """
        before = np.clip(np.searchsorted(self.stamps, at, side="right") - 1, 0, len(self.stamps) - 1)
        after = np.minimum(before + 1, len(self.stamps) - 1)
        start, start_odometry = self.poses[before], self.odometry[before]
        predicted = se2.compose(start, se2.between(start_odometry, readings))
        predicted_next = se2.compose(start, se2.between(start_odometry, self.odometry[after]))
        error = self.poses[after] - predicted_next
        error[:, 2] = se2.wrap(error[:, 2])
        span = self.travelled[after] - self.travelled[before]
        seconds = self.stamps[after] - self.stamps[before]
        by_travel = (travelled - self.travelled[before]) / np.where(span > 0.0, span, 1.0)
        by_time = (at - self.stamps[before]) / np.where(seconds > 0.0, seconds, 1.0)
        part = np.clip(np.where(span > 0.0, by_travel, by_time), 0.0, 1.0)
        result = predicted + part[:, None] * error
        result[:, 2] = se2.wrap(result[:, 2])
        return result


def _united(readings: Floats, scans: Floats) -> Floats:
    """Return the stamps of odometry readings (m,), increasing, and those of scans (n,) at which there is no reading."""
    after = np.searchsorted(readings, scans)
    nearest = np.minimum(
        np.abs(readings[np.minimum(after, len(readings) - 1)] - scans),
        np.abs(scans - readings[np.maximum(after - 1, 0)]),
    )
    return np.union1d(readings, scans[nearest >= SAME_STAMP])
