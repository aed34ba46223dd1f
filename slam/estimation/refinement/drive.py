"""A whole drive, looked at again: everything that was sighted, and where it belongs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ...geometry.segments import Floats, Integers
from ...mapping.trajectory_builder import Path
from ...odometry.error_model import OdometryModel
from ...preprocessing.scan_queue import NO_FEATURES, ProcessedScan
from ..slam_state import CARRIED_SIGMAS

ASTRAY_SIGMAS = np.array([0.5, 0.5, 0.3])  # metres, metres, radians: of a motion in which odometry proved wrong


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """n sightings in time order, k of which are keyframes.

    keyframes  (k,) rows of those
    anchors    (n,) the keyframe that each sighting hangs on, and `relative` (n, 3), its pose relative to it
    informations  (n, 3, 3) of what each was placed by on line, in its own frame; zeros where it was not
    carried    rows of the sightings to which the robot was moved without odometry's knowing; a new drive begins so, too
    """

    sightings: Sequence[ProcessedScan]
    keyframes: Integers
    anchors: Integers
    relative: Floats
    informations: Floats
    carried: frozenset[int]

    def __len__(self) -> int:
        return len(self.sightings)

    @property
    def stamps(self) -> Floats:
        """(n,) seconds."""
        return np.array([sighting.stamp for sighting in self.sightings])

    @property
    def odometry(self) -> Floats:
        """(n, 3) where odometry was."""
        return np.array([sighting.odometry for sighting in self.sightings]).reshape(-1, 3)

    @property
    def kept(self) -> NDArray[np.bool_]:
        """(n,) whether what a sighting showed was kept."""
        return np.array([sighting.seen is not NO_FEATURES for sighting in self.sightings])

    def path(self, keyframe_poses: Floats, poses: Floats) -> Path:
        """The path with all sightings at `poses` (n, 3), hung on keyframes at theirs (k, 3)."""
        path = Path()
        relative = se2.between(keyframe_poses[self.anchors], poses).reshape(-1, 3)
        for row, sighting in enumerate(self.sightings):
            path.add(sighting.stamp, int(self.anchors[row]), relative[row], self.informations[row])
        return path

    def poses(self, keyframe_poses: Floats) -> Floats:
        """(n, 3) of all sightings, given the keyframes' poses (k, 3)."""
        return se2.compose(keyframe_poses[self.anchors], self.relative).reshape(-1, 3)

    def motion(self, row: int, to: int, model: OdometryModel, astray: NDArray[np.bool_]) -> tuple[se2.Pose, Floats]:
        """Odometry's motion from one sighting to another, and its covariance (3, 3).

        `astray` (n,) says at which sightings odometry was found to be wrong: it had stood still, or jumped.
        """
        motion = se2.between(self.sightings[row].odometry, self.sightings[to].odometry)
        if any(row < carried <= to for carried in self.carried):
            return motion, np.diag(CARRIED_SIGMAS**2)
        if astray[row : to + 1].any():
            return motion, np.diag(ASTRAY_SIGMAS**2)
        motion = model.corrected(motion)
        return motion, model.covariance(motion)

    def adrift(self, row: int, to: int, model: OdometryModel, astray: NDArray[np.bool_]) -> Floats:
        """(2, 2): what odometry's common errors add to the covariance of the position from one sighting to another, in
        the frame of its end; where odometry is not what led there, its covariance says all."""
        if astray[row : to + 1].any() or any(row < carried <= to for carried in self.carried):
            return np.zeros((2, 2))
        return model.adrift(self.motion(row, to, model, astray)[0], self.informations[to])

    def start_of(self, keyframe: int) -> int:
        """The row of the sighting from which odometry led to a keyframe: the keyframe before it, or, where a familiar
        place was passed in between without new keyframes, the first that hangs where the last before it hangs."""
        last = int(self.keyframes[keyframe]) - 1
        start = last
        while start > 0 and self.anchors[start - 1] == self.anchors[last]:
            start -= 1
        return max(start, int(self.keyframes[keyframe - 1]))


def drive_of(
    sightings: Sequence[ProcessedScan],
    path: Path,
    keyframe_stamps: Sequence[float],
    carried: Sequence[int],
    starts: Sequence[int] = (),
) -> Drive:
    """The drive of a run: all its sightings, its path, and when its keyframes were; `carried` are keyframes, `starts`
    rows from which on odometry does not continue what came before.

    A sighting that is not on the path hangs where odometry has it from the last one that is; or, where there is none
    since odometry began, from the next.
    """
    stamps, anchors, relative, informations = path.hung()
    keyframes = np.zeros(len(keyframe_stamps), dtype=np.int64)
    all_anchors = np.zeros(len(sightings), dtype=np.int64)
    all_relative, all_informations = np.zeros((len(sightings), 3)), np.zeros((len(sightings), 3, 3))
    placed = known = last = 0
    waiting: list[int] = []  # since odometry began anew
    for row, sighting in enumerate(sightings):
        if row in starts and row:
            waiting, last = [row], -1
        if known < len(keyframes) and sighting.stamp == keyframe_stamps[known]:
            keyframes[known] = row
            known += 1
        if placed < len(stamps) and sighting.stamp == stamps[placed]:
            all_anchors[row], all_relative[row] = anchors[placed], relative[placed]
            all_informations[row] = informations[placed]
            for before in waiting if last < 0 else ():
                motion = se2.between(sighting.odometry, sightings[before].odometry)
                all_anchors[before], all_relative[before] = anchors[placed], se2.compose(relative[placed], motion)
            placed, last = placed + 1, row
        elif last < 0:
            waiting.append(row)
        else:
            motion = se2.between(sightings[last].odometry, sighting.odometry)
            all_anchors[row], all_relative[row] = all_anchors[last], se2.compose(all_relative[last], motion)
    jumps = frozenset([*(int(keyframes[k]) for k in carried), *(row for row in starts if row)])
    return Drive(sightings, keyframes, all_anchors, all_relative, all_informations, jumps)
