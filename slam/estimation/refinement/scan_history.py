"""A whole drive, looked at again: everything that was sighted, and where it belongs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ...geometry.segments import Floats, Integers
from ...mapping.trajectory_builder import TrajectoryBuilder
from ...odometry.error_model import OdometryModel
from ...preprocessing.preprocessor import NO_FEATURES, ProcessedScan
from ..slam_state import UNMEASURED_MOTION_SIGMAS

ASTRAY_SIGMAS = np.array([0.5, 0.5, 0.3])  # metres, metres, radians: of a motion in which odometry proved wrong


@dataclass(frozen=True, slots=True, eq=False)
class ScanHistory:
    """n sightings in time order, k of which are keyframes.

    keyframes  (k,) rows of those
    anchors    (n,) the keyframe that each sighting hangs on, and `relative` (n, 3), its pose relative to it
    informations  (n, 3, 3) of what each was placed by on line, in its own frame; zeros where it was not
    carried    rows of the sightings to which the robot was moved without odometry's knowing; a new drive begins so, too
    """

    scans: Sequence[ProcessedScan]
    keyframes: Integers
    anchors: Integers
    relative: Floats
    informations: Floats
    kidnapped: frozenset[int]

    def __len__(self) -> int:
        return len(self.scans)

    @property
    def stamps(self) -> Floats:
        """(n,) seconds."""
        return np.array([scan.stamp for scan in self.scans])

    @property
    def odometry(self) -> Floats:
        """(n, 3) where odometry was."""
        return np.array([scan.odometry for scan in self.scans]).reshape(-1, 3)

    @property
    def kept(self) -> NDArray[np.bool_]:
        """(n,) whether what a sighting showed was kept."""
        return np.array([scan.features is not NO_FEATURES for scan in self.scans])

    def path(self, keyframe_poses: Floats, poses: Floats) -> TrajectoryBuilder:
        """The path with all sightings at `poses` (n, 3), hung on keyframes at theirs (k, 3)."""
        path = TrajectoryBuilder()
        relative = se2.between(keyframe_poses[self.anchors], poses).reshape(-1, 3)
        for row, scan in enumerate(self.scans):
            path.add(scan.stamp, int(self.anchors[row]), relative[row], self.informations[row])
        return path

    def poses(self, keyframe_poses: Floats) -> Floats:
        """(n, 3) of all sightings, given the keyframes' poses (k, 3)."""
        return se2.compose(keyframe_poses[self.anchors], self.relative).reshape(-1, 3)

    def motion(
        self, row: int, to: int, model: OdometryModel, odometry_wrong: NDArray[np.bool_]
    ) -> tuple[se2.Pose, Floats]:
        """Odometry's motion from one sighting to another, and its covariance (3, 3).

        `astray` (n,) says at which sightings odometry was found to be wrong: it had stood still, or jumped.
        """
        motion = se2.between(self.scans[row].odometry, self.scans[to].odometry)
        if any(row < kidnapped <= to for kidnapped in self.kidnapped):
            return motion, np.diag(UNMEASURED_MOTION_SIGMAS**2)
        if odometry_wrong[row : to + 1].any():
            return motion, np.diag(ASTRAY_SIGMAS**2)
        motion = model.corrected(motion)
        return motion, model.covariance(motion)

    def correlated_drift(self, row: int, to: int, model: OdometryModel, odometry_wrong: NDArray[np.bool_]) -> Floats:
        """(2, 2): what odometry's common errors add to the covariance of the position from one sighting to another, in
        the frame of its end; where odometry is not what led there, its covariance says all."""
        if odometry_wrong[row : to + 1].any() or any(row < kidnapped <= to for kidnapped in self.kidnapped):
            return np.zeros((2, 2))
        return model.correlated_drift(self.motion(row, to, model, odometry_wrong)[0], self.informations[to])

    def start_of(self, keyframe: int) -> int:
        """The row of the sighting from which odometry led to a keyframe: the keyframe before it, or, where a familiar
        place was passed in between without new keyframes, the first that hangs where the last before it hangs."""
        last = int(self.keyframes[keyframe]) - 1
        start = last
        while start > 0 and self.anchors[start - 1] == self.anchors[last]:
            start -= 1
        return max(start, int(self.keyframes[keyframe - 1]))


def build_scan_history(
    scans: Sequence[ProcessedScan],
    path: TrajectoryBuilder,
    keyframe_stamps: Sequence[float],
    kidnapped: Sequence[int],
    starts: Sequence[int] = (),
) -> ScanHistory:
    """The drive of a run: all its sightings, its path, and when its keyframes were; `carried` are keyframes, `starts`
    rows from which on odometry does not continue what came before.

    A sighting that is not on the path hangs where odometry has it from the last one that is; or, where there is none
    since odometry began, from the next.
    """
    stamps, anchors, relative, informations = path.hung()
    keyframes = np.zeros(len(keyframe_stamps), dtype=np.int64)
    all_anchors = np.zeros(len(scans), dtype=np.int64)
    all_relative, all_informations = np.zeros((len(scans), 3)), np.zeros((len(scans), 3, 3))
    placed = known = last = 0
    waiting: list[int] = []  # since odometry began anew
    for row, scan in enumerate(scans):
        if row in starts and row:
            waiting, last = [row], -1
        if known < len(keyframes) and scan.stamp == keyframe_stamps[known]:
            keyframes[known] = row
            known += 1
        if placed < len(stamps) and scan.stamp == stamps[placed]:
            all_anchors[row], all_relative[row] = anchors[placed], relative[placed]
            all_informations[row] = informations[placed]
            for before in waiting if last < 0 else ():
                motion = se2.between(scan.odometry, scans[before].odometry)
                all_anchors[before], all_relative[before] = anchors[placed], se2.compose(relative[placed], motion)
            placed, last = placed + 1, row
        elif last < 0:
            waiting.append(row)
        else:
            motion = se2.between(scans[last].odometry, scan.odometry)
            all_anchors[row], all_relative[row] = all_anchors[last], se2.compose(all_relative[last], motion)
    jumps = frozenset([*(int(keyframes[k]) for k in kidnapped), *(row for row in starts if row)])
    return ScanHistory(scans, keyframes, all_anchors, all_relative, all_informations, jumps)
