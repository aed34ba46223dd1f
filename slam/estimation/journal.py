"""Record of a session: all processed scans and all odometry, for refinement and storage."""

from __future__ import annotations

import bisect
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers import se2

from ..mapping.odometry_segments import OdometrySegments
from ..mapping.trajectory_builder import TrajectoryBuilder
from ..matching.scan_features import ScanFeatures
from ..odometry.history import OdometryHistory, wheel_travel
from ..preprocessing.preprocessor import ProcessedScan
from ..preprocessing.scan_sequence import ScanSequence
from .refinement import ScanHistory, build_scan_history
from .slam_state import SlamState

# Metres of wheel travel within which the robot counts as standing. Origin: chosen, far below the distance of keyframes.
STANDING_TRAVEL = 0.01
# Scans at one place whose features are kept: more of a robot that stands show nothing new, and it may stand on its
# charger for days. Origin: chosen, ten seconds of a common lidar; not measured.
STANDING_SCANS = 100
# Scans until it is certain whether a scan has become a keyframe: a new part of the map may begin with it when the robot
# is found to be lost. Origin: chosen, several times as many as tracking waits for that.
UNDECIDED_SCANS = 20
# Last scans whose features are kept if they are only localised: older ones are not matched again at the end, as a robot
# may be localised for weeks. Origin: chosen, half an hour of a common lidar, some 100 MB.
LOCALISED_SCANS = 20_000


class Journal:
    """Processed scans and odometry, of an earlier session that is continued and of this run.

    The features of a scan take most of its memory. They are dispensable if the map does not need them: those of a scan
    in a familiar place, those of a robot that stands, after the first STANDING_SCANS there, and those of older scans
    that were only localised. Features of keyframes never are.

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
        """`keep_all_features` also keeps dispensable features: memory then grows with time."""
        self.scans = ScanSequence(scans)
        self.segments = OdometrySegments(odometry, starts)
        self.first_row, self.resumed_at = len(self.scans), resumed_at
        self._keep_all_features = keep_all_features
        self._dispensable: set[int] = set()  # rows whose features are kept nevertheless
        self._standing_at: se2.Pose | None = None  # by odometry
        self._standing_since = 0  # row
        self._familiar: deque[int] = deque()  # rows of scans in familiar places that may still become keyframes
        self._localised: list[tuple[float, float]] = []  # rows of the scans that are only localised: from, up to

    def add(self, scan: ProcessedScan) -> None:
        """Append a scan."""
        at = self._standing_at
        if at is None or wheel_travel(se2.between(at, scan.odometry)) > STANDING_TRAVEL:
            self._standing_at, self._standing_since = scan.odometry, len(self.scans)
        self.scans.append(scan)

    def features_at(self, stamp: float) -> ScanFeatures:
        """Return the features of the scan with a stamp (seconds)."""
        return self.scans.features(int(np.searchsorted(self.scans.stamps, stamp)))

    def note_familiar_place(self) -> None:
        """State that the last scan was taken in a familiar place: its features did not enter the map."""
        self._familiar.append(len(self.scans) - 1)

    def mark_dispensable(self, keyframe_stamps: Sequence[float]) -> None:
        """Mark the scans as dispensable that certainly are by now; to be called after each scan.

        keyframe_stamps  seconds, of all keyframes so far, in time order
        """
        self._mark_localised()
        row = len(self.scans) - 1 - UNDECIDED_SCANS
        familiar = bool(self._familiar) and self._familiar[0] == row
        if familiar:
            self._familiar.popleft()
        if familiar or row - self._standing_since >= STANDING_SCANS:
            self._mark_unless_keyframe(row, keyframe_stamps)

    def mark_rest_dispensable(self, keyframe_stamps: Sequence[float]) -> None:
        """Mark the last scans in familiar places at the end of the run, when none becomes a keyframe any more."""
        while self._familiar:
            self._mark_unless_keyframe(self._familiar.popleft(), keyframe_stamps)

    def _mark_localised(self) -> None:
        """Mark the scan before the last LOCALISED_SCANS if it was only localised."""
        row = len(self.scans) - 1 - LOCALISED_SCANS
        if any(begin <= row < end for begin, end in self._localised):
            self._mark(row)

    def _mark_unless_keyframe(self, row: int, keyframe_stamps: Sequence[float]) -> None:
        """Mark a scan, unless it is a keyframe."""
        stamp = float(self.scans.stamps[row])
        place = bisect.bisect_left(keyframe_stamps, stamp)
        if place == len(keyframe_stamps) or keyframe_stamps[place] != stamp:
            self._mark(row)

    def _mark(self, row: int) -> None:
        """Drop the features of a scan, or remember that they are dispensable if all are kept."""
        if self._keep_all_features:
            self._dispensable.add(row)
        else:
            self.scans.drop_features([row])

    def begin_localising(self) -> None:
        """State that scans are only localised from the next one on, and that none becomes a keyframe."""
        self._localised.append((len(self.scans), np.inf))

    def end_localising(self) -> None:
        """State that the map is extended again; a part of it may begin with one of the last UNDECIDED_SCANS."""
        begin, _ = self._localised.pop()
        self._localised.append((begin, len(self.scans) - UNDECIDED_SCANS))

    def begin_run(self) -> None:
        """Take the next scan as the first one of this run: those before were queued in the earlier session."""
        self.first_row = len(self.scans)

    def start_odometry_segment(self) -> OdometryHistory:
        """Start a new odometry segment with the next scan."""
        return self.segments.begin(len(self.scans))

    def drop_earlier_session(self) -> None:
        """Keep only the scans and the odometry of this run."""
        self.segments.keep_last()
        self.scans = self.scans[self.first_row :]
        self._dispensable = {row - self.first_row for row in self._dispensable if row >= self.first_row}
        self._familiar = deque(row - self.first_row for row in self._familiar if row >= self.first_row)
        self._localised = [(begin - self.first_row, end - self.first_row) for begin, end in self._localised]
        self._standing_at = None
        self.first_row = 0

    @property
    def in_new_odometry_segment(self) -> bool:
        """True if this run has an odometry segment of its own."""
        return self.segments.starts[-1] >= self.first_row

    @property
    def stamp_before(self) -> float:
        """Stamp of the last scan before those of this run, seconds; -inf if there is none."""
        return float(self.scans.stamps[self.first_row - 1]) if self.first_row else -np.inf

    def any_tracked(self, trajectory: TrajectoryBuilder) -> bool:
        """Return True if any scan of this run is on the trajectory."""
        stamps = trajectory.relative_poses()[0]
        return bool(len(stamps)) and bool(stamps[-1] > self.stamp_before)

    def history(self, state: SlamState) -> ScanHistory:
        """Return all scans with their poses relative to keyframes, for refinement."""
        return build_scan_history(
            self.scans,
            state.trajectory,
            state.keyframe_stamps,
            self.segments.histories,
            state.kidnapped_keyframes,
            self.segments.starts,
        )

    def without_dispensable_features(self, history: ScanHistory) -> ScanHistory:
        """Return the history as if only the features of scans that matter to the map had been kept."""
        scans = self.scans.copy()
        scans.drop_features(self._dispensable)
        return replace(history, scans=scans)
