"""Contents of a session, apart from the files it is written to: a run needs the library of tables at its end only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers import se2
from drivers.messages import Scan
from features import LearnedNoise

from ..config import Config
from ..estimation.refinement import ScanHistory, build_scan_history
from ..estimation.slam_state import SlamState
from ..geometry.segments import Floats
from ..odometry.history import OdometryHistory
from ..preprocessing.preprocessor import ProcessedScan
from .recorded_stamps import as_read

if TYPE_CHECKING:
    from .sessions.header import Recording


@dataclass(slots=True, eq=False)
class StoredSession:
    """Contents of a session.

    config          settings in effect
    slam_state      map, graph, trajectory and learned models
    scans           all processed scans, in time order
    odometry        all readings of each odometry segment
    starts          rows of the scans at which an odometry segment starts
    noise           last estimate of the noise of a ray
    recordings      recordings that the session was made from
    loop_decisions  all decisions on loop closure candidates, with the values of `summary.json`
    queued_scans    last scans, whose sweep odometry did not cover yet: part of the trajectory in the results, but not
                    of `slam_state`, since more odometry may follow
    second_noise    as noise, of the second lidar; None if there is none
    """

    config: Config
    slam_state: SlamState
    scans: Sequence[ProcessedScan]
    odometry: Sequence[OdometryHistory]
    starts: Sequence[int]
    noise: LearnedNoise
    recordings: list[Recording] = field(default_factory=list)
    loop_decisions: Sequence[Mapping[str, Any]] = ()
    queued_scans: Sequence[Scan] = ()
    second_noise: LearnedNoise | None = None

    @property
    def latest(self) -> float:
        """Stamp of the last measurement, seconds; -inf if there is none."""
        stamps = [history.latest for history in self.odometry]
        stamps += [scan.stamp for scan in self.scans[-1:]] + [scan.stamp for scan in self.queued_scans]
        return max(stamps, default=-np.inf)

    @property
    def last_mount(self) -> tuple[float, float, float] | None:
        """Mount of the first lidar in the last recording if it was set or found; None if the scans state it."""
        if not self.recordings:
            return None
        last = self.recordings[-1]
        if last.settings is not None:
            return last.settings.lidar.mount
        return last.mounts[0] if last.mounts else None

    @property
    def config_to_continue(self) -> Config:
        """Settings of a run that continues the session: if they state no mount, with that of the last recording."""
        mount = self.last_mount
        return self.config if mount is None or self.config.lidar.mount is not None else self.config.with_mount(mount)

    def lidars_at(self, stamp: float, unknown: Floats) -> Floats:
        """Return the positions (k, 2) of the lidars on the base in the recording at a stamp; `unknown` without one."""
        recording = next((one for one in reversed(self.recordings) if one.first <= stamp), None)
        return unknown if recording is None or not recording.lidars else np.array(recording.lidars)[:, :2]

    @property
    def first_pose(self) -> se2.Pose:
        """Pose (3,) of the first keyframe in the map."""
        return np.array(self.slam_state.mapper.keyframe_poses[0])

    def stamp_as_read(self, stamp: float) -> float:
        """Return a stamp of `trajectory.tum`, seconds, on the clock of the session, with which it was read."""
        summary = {"recordings": [recording.model_dump() for recording in self.recordings]}
        return float(as_read(np.array([stamp]), summary)[0])

    def copy(self) -> StoredSession:
        """Return a copy that a run which continues this session does not change."""
        odometry = [history.copy() for history in self.odometry]
        state, scans = self.slam_state.copy(), list(self.scans)
        return replace(self, slam_state=state, scans=scans, odometry=odometry, starts=list(self.starts))

    def scan_history(self) -> ScanHistory:
        """Return all processed scans with their poses relative to keyframes."""
        slam_state = self.slam_state
        return build_scan_history(
            self.scans,
            slam_state.trajectory,
            slam_state.keyframe_stamps,
            self.odometry,
            slam_state.kidnapped_keyframes,
            self.starts,
        )
