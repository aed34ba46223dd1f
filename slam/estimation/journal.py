"""Record of a session: all processed scans and all odometry, for refinement and storage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..mapping.odometry_segments import OdometrySegments
from ..mapping.trajectory_builder import TrajectoryBuilder
from ..odometry.history import OdometryHistory
from ..preprocessing.preprocessor import ProcessedScan
from ..preprocessing.scan_sequence import ScanSequence
from .refinement import ScanHistory, build_scan_history
from .slam_state import SlamState


class Journal:
    """Processed scans and odometry, of an earlier session that is continued and of this run.

    scans        in time order
    segments     odometry, split where it is not continuous
    first_row    row in `scans` of this run's first scan
    resumed_at   latest stamp of the earlier session, seconds; -inf without one
    """

    def __init__(
        self,
        scans: Sequence[ProcessedScan] = (),
        odometry: Sequence[OdometryHistory] = (),
        starts: Sequence[int] = (),
        resumed_at: float = -np.inf,
        *,
        keep_all_features: bool,
    ) -> None:
        """`keep_all_features` also keeps the features of scans in familiar places: memory then grows with time."""
        self.scans = ScanSequence(scans)
        self.segments = OdometrySegments(odometry, starts)
        self.first_row, self.resumed_at = len(self.scans), resumed_at
        self._keep_all_features = keep_all_features
        self._in_familiar_place: set[int] = set()  # rows whose features are kept nevertheless

    def add(self, scan: ProcessedScan) -> None:
        """Append a scan."""
        self.scans.append(scan)

    def mark_last_familiar(self) -> None:
        """Mark the last scan as taken in a familiar place: its features did not enter the map."""
        row = len(self.scans) - 1
        if self._keep_all_features:
            self._in_familiar_place.add(row)
        else:
            self.scans.drop_features([row])

    def start_odometry_segment(self) -> OdometryHistory:
        """Start a new odometry segment with the next scan, which is the first one of this run."""
        self.first_row = len(self.scans)
        return self.segments.begin(len(self.scans))

    def drop_earlier_session(self) -> None:
        """Keep only the scans and the odometry of this run."""
        self.segments.keep_last()
        self.scans = self.scans[self.first_row :]
        self._in_familiar_place = {row - self.first_row for row in self._in_familiar_place if row >= self.first_row}
        self.first_row = 0

    @property
    def in_new_odometry_segment(self) -> bool:
        """True if this run has an odometry segment of its own."""
        return self.segments.starts[-1] >= self.first_row

    @property
    def stamp_before(self) -> float:
        """Stamp of the last scan before those of this run, seconds; -inf if there is none."""
        return self.scans[self.first_row - 1].stamp if self.first_row else -np.inf

    def any_tracked(self, trajectory: TrajectoryBuilder) -> bool:
        """Return True if any scan of this run is on the trajectory."""
        stamps = trajectory.relative_poses()[0]
        return bool(len(stamps)) and bool(stamps[-1] > self.stamp_before)

    def history(self, state: SlamState) -> ScanHistory:
        """Return all scans with their poses relative to keyframes, for refinement."""
        return build_scan_history(
            self.scans, state.trajectory, state.keyframe_stamps, state.kidnapped_keyframes, self.segments.starts
        )

    def without_familiar_features(self, history: ScanHistory) -> ScanHistory:
        """Return the history as if the features of scans in familiar places had not been kept."""
        scans = self.scans.copy()
        scans.drop_features(self._in_familiar_place)
        return replace(history, scans=scans)
