"""The story of a scan: measured, straightened, condensed into walls and corners, laid over the map, and made part of it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan
from features import Extractor, Noise

from .association import associate
from .config import Config
from .deskew import deskew, loosen
from .errors import MapError
from .events import (
    Event,
    Finished,
    KeyframeAdded,
    LinesMerged,
    MapCorners,
    MapLines,
    MapUpdated,
    Noticed,
    ScanTracked,
    Sink,
    TruthSeen,
)
from .local_map import empty_local_map
from .mapper import KeyframeView, Mapper, Merge
from .odometry import OdometryHistory, OdometryNoise
from .path import Path
from .registration import register
from .segments import CornerPoints, Floats, Segments, corner_points, segments_from_lines
from .snapshot import map_corners, map_lines
from .statistics import Clock, RunStatistics

KEYFRAME_DISTANCE = 0.25  # metres
KEYFRAME_TURN = math.radians(8.0)
# Added to the odometry's own uncertainty when predicting a scan's pose: wheels slip and clocks differ. Metres, metres, radians.
PREDICTION_SIGMAS = np.array([0.05, 0.05, math.radians(4.0)])
LONGEST_WAIT = 20  # scans that wait for the odometry to catch up before they are taken without
MAP_EVENT_INTERVAL = 20  # keyframes between two events with the whole map


class Slam:
    """2-D SLAM with walls and corners. Feed it messages in time order, read the pose whenever you like, then finish.

    slam = Slam()
    for message in drivers.open("intel.clf"):
        slam.add(message)
    result = slam.finish()
    """

    def __init__(self, config: Config | None = None, sinks: Sequence[Sink] = ()) -> None:
        self.config = config or Config()
        self._sinks = tuple(sinks)
        lidar = self.config.lidar
        self._extractor = Extractor(
            Noise(lidar.sigma_range, lidar.sigma_bearing),
            method=self.config.features.segmentation,
            estimator=self.config.features.estimator,
            adapt_noise=lidar.adapt_noise,
            range_min=lidar.range_min,
            range_max=lidar.range_max,
        )
        self._odometry = OdometryHistory()
        self._odometry_noise = OdometryNoise(self.config.odometry)
        self._waiting: deque[Scan] = deque()
        self._mapper = Mapper()
        self._local_map = empty_local_map()
        self._path = Path()
        self._statistics = RunStatistics()
        self._keyframe_stamps: list[float] = []
        self._told_keyframes = np.zeros((0, 3))
        self._pose = np.zeros(3)
        self._scan_odometry = np.zeros(3)
        self._keyframe_odometry = np.zeros(3)

    # --- what goes in

    def add(self, message: Message) -> None:
        """Take the next message. A scan is worked on once the odometry covers its sweep."""
        match message:
            case Odometry():
                self._odometry.add(message)
            case Scan():
                self._take_scan(message)
            case GroundTruth():
                self._emit(TruthSeen(message.stamp, message.pose))
        while self._waiting and (self._covered(self._waiting[0]) or len(self._waiting) > LONGEST_WAIT):
            self._add_scan(self._waiting.popleft())

    def _take_scan(self, scan: Scan) -> None:
        self._statistics.scans += 1
        if not np.isfinite(scan.ranges).any():
            self._statistics.empty_scans += 1
        self._waiting.append(scan)
        if not len(self._odometry) and len(self._waiting) > LONGEST_WAIT:
            self._waiting.popleft()
            self._statistics.scans_without_odometry += 1

    def _covered(self, scan: Scan) -> bool:
        sweep = float(scan.time_offsets[-1]) if len(scan.time_offsets) else 0.0
        return scan.stamp + sweep <= self._odometry.latest

    # --- the story of a scan

    def _add_scan(self, scan: Scan) -> None:
        clock = Clock()
        mount = self._mount(scan)
        sweep = deskew(scan, self._odometry, mount)
        features = self._extractor.extract(sweep.ranges, sweep.bearings)
        segments = segments_from_lines(features.lines, mount)
        corners = corner_points(features.corners, segments, mount)
        segments, corners = loosen(segments, corners, features.lines, sweep, self._odometry_noise.rates)
        clock.lap("features")
        uncertainty = self._track(sweep.stamp, segments, corners)
        clock.lap("registration")
        if self._mapper.keyframe_count == 0 or self._moved_enough():
            view, merge = self._extend_map(segments, corners, uncertainty, clock)
            self._keyframe_stamps.append(sweep.stamp)
            if self._sinks:
                self._tell_keyframe(sweep.stamp, view, merge, clock, se2.transform(mount, sweep.points()))
        keyframe = self._mapper.keyframe_count - 1
        self._path.add(sweep.stamp, keyframe, se2.between(self._mapper.pose, self._pose))

    def _track(self, stamp: float, segments: Segments, corners: CornerPoints) -> Floats:
        """Find the base's pose at a scan; returns the pose's covariance (3, 3) against the local map, in its own frame."""
        odometry, flatness = self._odometry.at(stamp), self._mapper.flatness.variance
        first = self._mapper.keyframe_count == 0
        step = np.zeros(3) if first else se2.between(self._scan_odometry, odometry)
        prior = np.linalg.inv(self._odometry_noise.covariance(step) + np.diag(PREDICTION_SIGMAS**2))
        found = register(se2.compose(self._pose, step), prior, segments, corners, self._local_map, flatness)
        self._pose, self._scan_odometry = found.pose, odometry
        self._statistics.explained.append(found.explained)
        if found.recovered:
            self._statistics.recovered += 1
            self._emit(Noticed(stamp, "odometry was far off; the pose was found again in the map"))
        self._emit(ScanTracked(stamp, self._pose, odometry, found.explained, self._mapper.keyframe_count - 1))
        return np.asarray(np.linalg.inv(found.information + prior), dtype=np.float64)

    def _extend_map(
        self, segments: Segments, corners: CornerPoints, uncertainty: Floats, clock: Clock
    ) -> tuple[KeyframeView, Merge | None]:
        """Make the scan a keyframe: give its features to landmarks, solve, and see what the map around now looks like."""
        association = associate(
            self._pose, uncertainty, segments, corners, self._local_map, self._mapper.flatness.variance
        )
        clock.lap("association")
        motion = None
        if self._mapper.keyframe_count:
            moved = se2.between(self._keyframe_odometry, self._scan_odometry)
            self._odometry_noise.learn(moved, se2.between(self._mapper.pose, self._pose))
            motion = (moved, self._odometry_noise.covariance(moved))
        view = self._mapper.add_keyframe(self._pose, motion, segments, corners, association, self._local_map)
        clock.lap("graph")
        self._local_map, merge = self._mapper.refresh(view)
        self._pose, self._keyframe_odometry = self._mapper.pose, self._scan_odometry
        clock.lap("local map")
        self._statistics.add_keyframe(clock)
        self._statistics.merged_walls += merge is not None
        return view, merge

    def _moved_enough(self) -> bool:
        moved = se2.between(self._mapper.pose, self._pose)
        return bool(np.hypot(moved[0], moved[1]) > KEYFRAME_DISTANCE or abs(moved[2]) > KEYFRAME_TURN)

    def _mount(self, scan: Scan) -> se2.Pose:
        if self.config.lidar.mount is not None:
            return np.array(self.config.lidar.mount)
        return np.zeros(3) if scan.mount is None else scan.mount

    # --- what comes out

    @property
    def pose(self) -> se2.Pose:
        """The base's pose [x, y, heading] in the map at the last scan."""
        return self._pose.copy()

    @property
    def walls(self) -> MapLines:
        """The walls as they are known now, without covariances: those cost time, `finish` gives them."""
        return map_lines(self._mapper.landmarks, self._mapper.graph, covariances=False)

    @property
    def corners(self) -> MapCorners:
        """The corners as they are known now, without covariances."""
        return map_corners(self._mapper.landmarks, self._mapper.graph, covariances=False)

    def finish(self) -> Finished:
        """Work off what waits, settle the estimate, and return path and map with the covariances of their marginals.

        Raises MapError where there was nothing to make a map of.
        """
        if not self._statistics.scans:
            raise MapError("no laser scan in it, so there is nothing to map")
        if not len(self._odometry):
            raise MapError(f"{self._statistics.scans} scans, but no odometry; SLAM needs both")
        while self._waiting:
            self._add_scan(self._waiting.popleft())
        self._mapper.settle()
        keyframes = self._mapper.graph.keyframe_poses(self._mapper.keyframe_count)
        stamps, poses = self._path.at_odometry(keyframes, self._odometry)
        result = Finished(
            lines=map_lines(self._mapper.landmarks, self._mapper.graph, covariances=True),
            corners=map_corners(self._mapper.landmarks, self._mapper.graph, covariances=True),
            keyframe_stamps=np.array(self._keyframe_stamps),
            keyframes=keyframes,
            stamps=stamps,
            poses=poses,
            summary=self._summary(),
        )
        self._emit(result)
        return result

    def keyframe_covariance(self, index: int) -> Floats:
        """(3, 3): covariance of a keyframe's pose, in the keyframe's own frame (metres, metres, radians)."""
        return self._mapper.graph.keyframe_covariance(index)

    def _summary(self) -> dict[str, object]:
        return {
            "scans": self._statistics.scans,
            "keyframes": self._mapper.keyframe_count,
            "factors": self._mapper.graph.factor_count,
            "merged_walls": self._statistics.merged_walls,
            "odometry_walk": [round(float(rate) ** 0.5, 5) for rate in self._odometry_noise.rates],
            "sigma_range": round(self._extractor.noise.sigma_range, 5),
            "wall_unevenness": round(math.sqrt(self._mapper.flatness.variance), 5),
            "timings": self._statistics.timings(),
            "health": self._statistics.health(),
        }

    def _emit(self, event: Event) -> None:
        for sink in self._sinks:
            sink.handle(event)

    def _tell_keyframe(
        self, stamp: float, view: KeyframeView, merge: Merge | None, clock: Clock, points: Floats
    ) -> None:
        """Tell the listeners of the last keyframe, and of the whole map every so often."""
        mapper, index = self._mapper, self._mapper.keyframe_count - 1
        self._emit(
            KeyframeAdded(
                index=index,
                stamp=stamp,
                pose=mapper.pose,
                pose_covariance=mapper.pose_covariances[-1],
                odometry=self._scan_odometry,
                points=points,
                segments=view.segments,
                corners=view.corners,
                line_match=view.walls,
                line_gate=view.wall_distance,
                corner_match=view.corner_landmarks,
                corner_gate=view.corner_distance,
                new_lines=view.new_walls,
                sigma_range=self._extractor.noise.sigma_range,
                timings=dict(clock.laps),
                counts={
                    "walls": len(mapper.landmarks.walls),
                    "corners": len(mapper.landmarks.corners),
                    "factors": mapper.graph.factor_count,
                },
            )
        )
        if merge is not None:
            self._emit(LinesMerged(index, stamp, merge.kept, merge.absorbed, merge.distance))
        if index % MAP_EVENT_INTERVAL == 0:
            self._tell_map(stamp)

    def _tell_map(self, stamp: float) -> None:
        keyframes = self._mapper.graph.keyframe_poses(self._mapper.keyframe_count)
        moved = keyframes[: len(self._told_keyframes), :2] - self._told_keyframes[:, :2]
        self._told_keyframes = keyframes
        self._emit(
            MapUpdated(
                index=len(keyframes) - 1,
                stamp=stamp,
                keyframes=keyframes,
                lines=self.walls,
                corners=self.corners,
                chi2=self._mapper.graph.chi2(),
                shift=float(np.max(np.hypot(moved[:, 0], moved[:, 1]), initial=0.0)),
            )
        )
