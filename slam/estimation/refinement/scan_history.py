"""All processed scans of a session with their poses relative to keyframes, as input of refinement."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.immutable import immutable

from ...geometry.segments import Floats, Integers
from ...mapping.trajectory_builder import TrajectoryBuilder
from ...odometry.dead_reckoning import DeadReckoning
from ...odometry.error_model import OdometryModel
from ...odometry.history import OdometryHistory
from ...preprocessing.preprocessor import ProcessedScan
from ...preprocessing.scan_sequence import ScanSequence
from ..keyframe_motions import UNMEASURED_MOTION_SIGMAS

# Metres, metres, radians: standard deviations of a motion for which odometry was found to be wrong.
# Origin: chosen; not measured.
WRONG_ODOMETRY_SIGMAS = np.array([0.5, 0.5, 0.3])


@immutable
class ScanMotions:
    """Odometry's motions from each of n scans to the next one.

    measured     (n - 1, 3)
    corrected    (n - 1, 3) without systematic errors
    covariances  (n - 1, 3, 3) of `corrected`, in the frames at the motions' ends
    unmeasured   (n - 1,) true for motions that odometry does not lead along; see `ScanHistory.kidnapped`
    """

    measured: Floats
    corrected: Floats
    covariances: Floats
    unmeasured: NDArray[np.bool_]

    def known(self, odometry_wrong: NDArray[np.bool_]) -> tuple[Floats, Floats]:
        """Return motions (n - 1, 3) and covariances (n - 1, 3, 3), as `ScanHistory.motion` does for any two scans.

        `odometry_wrong` (n,) is true for scans at which odometry was found to be wrong.
        """
        wrong = odometry_wrong[:-1] | odometry_wrong[1:]
        motions = np.where((wrong | self.unmeasured)[:, None], self.measured, self.corrected)
        covariances = np.where(wrong[:, None, None], np.diag(WRONG_ODOMETRY_SIGMAS**2), self.covariances)
        return motions, np.where(self.unmeasured[:, None, None], np.diag(UNMEASURED_MOTION_SIGMAS**2), covariances)


@immutable
class ScanHistory:
    """n processed scans in time order, k of which are keyframes.

    keyframes      (k,) rows of the keyframes
    own_keyframes  (n,) keyframe to which each scan's pose is relative
    relative       (n, 3) pose of each scan relative to its own keyframe
    informations   (n, 3, 3) of the online matches, in the scans' own frames; zeros if a scan was not matched
    readings       of odometry, those of all its segments
    kidnapped      rows of scans to which odometry does not lead: after kidnapping, or first of an odometry segment
    """

    scans: Sequence[ProcessedScan]
    keyframes: Integers
    own_keyframes: Integers
    relative: Floats
    informations: Floats
    readings: OdometryHistory
    kidnapped: frozenset[int]

    def __len__(self) -> int:
        return len(self.scans)

    @property
    def stamps(self) -> Floats:
        """Times of the scans (n,), seconds."""
        return ScanSequence.of(self.scans).stamps

    @property
    def odometry(self) -> Floats:
        """Odometry poses (n, 3) of the scans."""
        return ScanSequence.of(self.scans).odometry

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Mask (n,) of the scans to which odometry leads, see `ProcessedScan`."""
        return ScanSequence.of(self.scans).measured

    @property
    def has_features(self) -> NDArray[np.bool_]:
        """Mask (n,) of the scans whose features were stored."""
        return ScanSequence.of(self.scans).has_features

    @property
    def keyframe_scans(self) -> dict[int, ProcessedScan]:
        """Scans of the keyframes, by the number of the keyframe."""
        return {k: self.scans[row] for k, row in enumerate(self.keyframes.tolist())}

    @property
    def sweep_covariances(self) -> Floats:
        """Sweep covariances (k, 3, 3) of the keyframes, see `ScanFeatures`."""
        return np.array([self.scans[row].features.sweep_covariance for row in self.keyframes.tolist()])

    def trajectory(self, keyframe_poses: Floats, poses: Floats) -> TrajectoryBuilder:
        """Return the trajectory with the scans at `poses` (n, 3), relative to keyframes at their poses (k, 3)."""
        relative = se2.between(keyframe_poses[self.own_keyframes], poses).reshape(-1, 3)
        return TrajectoryBuilder.from_arrays(self.stamps, self.own_keyframes, relative, self.informations)

    def scan_poses(self, keyframe_poses: Floats) -> Floats:
        """Return the poses (n, 3) of all scans, given those of the keyframes (k, 3)."""
        return se2.compose(keyframe_poses[self.own_keyframes], self.relative).reshape(-1, 3)

    def motion(
        self, row: int, to: int, model: OdometryModel, odometry_wrong: NDArray[np.bool_]
    ) -> tuple[se2.Pose, Floats]:
        """Return odometry's motion from one scan to another, and its covariance (3, 3).

        `odometry_wrong` (n,) is true for scans at which odometry was found to be wrong: it had stopped, or jumped.
        """
        if any(row < kidnapped <= to for kidnapped in self.kidnapped):
            return se2.between(*self.odometry[[row, to]]), np.diag(UNMEASURED_MOTION_SIGMAS**2)
        if odometry_wrong[row : to + 1].any():
            return se2.between(*self.odometry[[row, to]]), np.diag(WRONG_ODOMETRY_SIGMAS**2)
        return DeadReckoning(model, self.readings).motion_and_covariance(
            self.scans[row].reading, self.scans[to].reading
        )

    def motions(self, model: OdometryModel) -> ScanMotions:
        """Return the motions from each scan to the next one."""
        odometry, unmeasured = self.odometry, np.zeros(max(len(self) - 1, 0), dtype=bool)
        unmeasured[[row - 1 for row in self.kidnapped if row]] = True
        measured = se2.between(odometry[:-1], odometry[1:])
        corrected, covariances = DeadReckoning(model, self.readings).motions_and_covariances(self.stamps, odometry)
        return ScanMotions(measured, corrected, covariances, unmeasured)

    def correlated_drift(self, row: int, to: int, model: OdometryModel, odometry_wrong: NDArray[np.bool_]) -> Floats:
        """Return the covariance (2, 2) of the position, in the frame of the scan `to`, due to correlated drift.

        It is zero if odometry is not used for the motion.
        """
        if odometry_wrong[row : to + 1].any() or any(row < kidnapped <= to for kidnapped in self.kidnapped):
            return np.zeros((2, 2))
        return model.correlated_drift(self.motion(row, to, model, odometry_wrong)[0], self.informations[to])

    def odometry_start(self, keyframe: int) -> int:
        """Return the row of the scan from which odometry leads to a keyframe.

        This is the previous keyframe. If the robot passed a familiar place in between without new keyframes, it is the
        first of the scans with the same own keyframe as the last scan before the keyframe.
        """
        last = int(self.keyframes[keyframe]) - 1
        start = last
        while start > 0 and self.own_keyframes[start - 1] == self.own_keyframes[last]:
            start -= 1
        return max(start, int(self.keyframes[keyframe - 1]))


def build_scan_history(
    scans: Sequence[ProcessedScan],
    trajectory: TrajectoryBuilder,
    keyframe_stamps: Sequence[float],
    odometry: Sequence[OdometryHistory],
    kidnapped: Sequence[int] = (),
    starts: Sequence[int] = (),
) -> ScanHistory:
    """Collect the history of a session.

    scans            n processed scans
    trajectory       poses of scans relative to keyframes; it may lack scans that were not tracked
    keyframe_stamps  k times of the keyframes
    odometry         readings of each odometry segment
    kidnapped        keyframes at which the robot had been kidnapped
    starts           rows at which an odometry segment starts

    A scan that is not on the trajectory is placed by odometry from the last scan that is, or, if there is none in its
    odometry segment, from the next one.
    """
    scans = ScanSequence.of(scans)
    of_scans = scans.odometry
    stamps, own, relative, informations = trajectory.relative_poses()
    keyframes = np.zeros(len(keyframe_stamps), dtype=np.int64)
    all_own = np.zeros(len(scans), dtype=np.int64)
    all_relative, all_informations = np.zeros((len(scans), 3)), np.zeros((len(scans), 3, 3))
    tracked = keyframe = last = 0
    waiting: list[int] = []  # scans since the start of the odometry segment that have no pose yet
    for row, stamp in enumerate(scans.stamps.tolist()):
        if row in starts and row:
            waiting, last = [row], -1
        if keyframe < len(keyframes) and stamp == keyframe_stamps[keyframe]:
            keyframes[keyframe] = row
            keyframe += 1
        if tracked < len(stamps) and stamp == stamps[tracked]:
            all_own[row], all_relative[row] = own[tracked], relative[tracked]
            all_informations[row] = informations[tracked]
            for before in waiting if last < 0 else ():
                motion = se2.between(of_scans[row], of_scans[before])
                all_own[before], all_relative[before] = own[tracked], se2.compose(relative[tracked], motion)
            tracked, last = tracked + 1, row
        elif last < 0:
            waiting.append(row)
        else:
            motion = se2.between(of_scans[last], of_scans[row])
            all_own[row], all_relative[row] = all_own[last], se2.compose(all_relative[last], motion)
    jumps = frozenset([*(int(keyframes[k]) for k in kidnapped), *(row for row in starts if row)])
    readings = OdometryHistory.joined(odometry)
    return ScanHistory(scans, keyframes, all_own, all_relative, all_informations, readings, jumps)
