"""The story of a scan: straightened, condensed into walls and corners, laid over the map, and made part of it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan
from features import Features

from .association import associate
from .config import Config
from .deskew import Sweep, deskew, loosen
from .errors import MapError
from .events import (
    Finished,
    MapCorners,
    MapLines,
    Noticed,
    ScanTracked,
    Sink,
    TruthSeen,
)
from .extraction import build_extractor
from .local_map import empty_local_map
from .loops.closer import LoopCloser
from .mapper import Mapper
from .odometry import OdometryHistory, OdometryNoise, fused_motion
from .path import Path
from .point_field import MOST_POINTS, RecentPoints, ScanPoints, thinned
from .registration import Registration, ScanFeatures
from .reporting import Extension, Reporter
from .segments import Floats, corner_points, segments_from_lines
from .snapshot import map_corners, map_lines
from .statistics import Clock, RunStatistics
from .tracking import Hold, Tracker

KEYFRAME_DISTANCE = 0.25  # metres
KEYFRAME_TURN = math.radians(8.0)
LONGEST_WAIT = 20  # scans that wait for the odometry to catch up before they are taken without


class Slam:
    """2-D SLAM with walls and corners. Feed it messages in time order, read the pose whenever you like, then finish.

    slam = Slam()
    for message in drivers.open("intel.clf"):
        slam.add(message)
    result = slam.finish()
    """

    def __init__(
        self, config: Config | None = None, sinks: Sequence[Sink] = (), loops: LoopCloser | None = None
    ) -> None:
        self.config = config or Config()
        self._reporter = Reporter(sinks)
        self._extractor = build_extractor(self.config)
        self._odometry = OdometryHistory()
        self._odometry_noise = OdometryNoise(self.config.odometry)
        self._waiting: deque[Scan] = deque()
        self._mapper = Mapper()
        self._local_map = empty_local_map()
        self._recent_points = RecentPoints()
        self._point_field = self._recent_points.field(np.zeros((0, 3)))
        self._loops = loops or LoopCloser()
        self._searched: tuple[float, int, se2.Pose] | None = None  # a scan that the next one must bear out
        self._tracker = Tracker(self._odometry_noise)
        self._path = Path()
        self._statistics = RunStatistics()
        self._keyframe_stamps: list[float] = []
        self._pose = np.zeros(3)
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
                self._reporter.tell(TruthSeen(message.stamp, message.pose))
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
        seen = self._in_base_frame(sweep, features, mount)
        clock.lap("features")
        odometry = self._odometry.at(sweep.stamp)
        found, hold = self._tracker.track(
            odometry, seen, self._local_map, self._point_field, self._mapper.flatness.variance
        )
        clock.lap("registration")
        self._note(sweep.stamp, found, hold, odometry)
        if hold is not Hold.NONE:
            self._pose = found.pose
        if hold is Hold.FIRM and (self._mapper.keyframe_count == 0 or self._moved_enough()):
            extension = self._extend_map(seen, found, odometry, clock)
            self._keyframe_stamps.append(sweep.stamp)
            sigma_range, laps = self._extractor.noise.sigma_range, dict(clock.laps)
            self._reporter.tell_keyframe(
                sweep.stamp, self._mapper, extension, odometry, seen.points.all, sigma_range, laps
            )
        self._hang_on_path(sweep.stamp, hold)

    def _hang_on_path(self, stamp: float, hold: Hold) -> None:
        """Make the scan's pose part of the path; one that was searched for, once the next scan has borne it out."""
        place = (stamp, self._mapper.keyframe_count - 1, se2.between(self._mapper.pose, self._pose))
        if self._searched is not None and hold is Hold.FIRM and self._tracker.search_held:
            self._path.add(*self._searched)
        self._searched = place if hold is Hold.SEARCHED else None
        if hold is Hold.FIRM:
            self._path.add(*place)

    def _in_base_frame(self, sweep: Sweep, features: Features, mount: se2.Pose) -> ScanFeatures:
        """What a scan shows, moved from the lidar's frame into the base's."""
        segments = segments_from_lines(features.lines, mount)
        corners = corner_points(features.corners, segments, mount)
        segments, corners = loosen(segments, corners, features.lines, sweep, self._odometry_noise)
        points = [thinned(se2.transform(mount, some), MOST_POINTS) for some in sweep.points(features.lines)]
        return ScanFeatures(segments, corners, ScanPoints(*points))

    def _note(self, stamp: float, found: Registration, hold: Hold, odometry: se2.Pose) -> None:
        """Count how the scan was placed, and tell the listeners."""
        self._statistics.explained.append(found.explained)
        if hold is Hold.SEARCHED:
            self._statistics.searched += 1
            self._reporter.tell(Noticed(stamp, "odometry is far off; the pose was searched for and found in the map"))
        elif hold is Hold.NONE:
            self._statistics.unplaced += 1
            self._reporter.tell(Noticed(stamp, "the scan fits nowhere near; left out"))
        keyframe = self._mapper.keyframe_count - 1
        self._reporter.tell(ScanTracked(stamp, found.pose, odometry, found.explained, keyframe))

    def _extend_map(self, seen: ScanFeatures, found: Registration, odometry: se2.Pose, clock: Clock) -> Extension:
        """Make the scan a keyframe: give its features to landmarks, solve, close loops, see the map around anew."""
        mapper = self._mapper
        information = found.information + found.point_information + self._tracker.prior(odometry)
        association = associate(
            self._pose,
            np.asarray(np.linalg.inv(information), dtype=np.float64),
            seen.segments,
            seen.corners,
            self._local_map,
            mapper.flatness.variance,
        )
        clock.lap("association")
        motion = None
        if mapper.keyframe_count:
            claimed, actual = se2.between(self._keyframe_odometry, odometry), se2.between(mapper.pose, self._pose)
            self._odometry_noise.learn(claimed, actual)
            motion = fused_motion(claimed, self._odometry_noise.covariance(claimed), actual, found.point_information)
        view = mapper.add_keyframe(self._pose, motion, seen.segments, seen.corners, association, self._local_map)
        clock.lap("graph")
        self._local_map, merge = mapper.refresh(view)
        decision = self._loops.look(mapper)
        if decision is not None:
            self._statistics.loops.append(decision)
            if decision.status == "accepted":
                self._local_map = mapper.local_map(view)
        self._recent_points.add(mapper.keyframe_count - 1, seen.points)
        self._point_field = self._recent_points.field(mapper.graph.some_poses(self._recent_points.keyframes))
        self._pose, self._keyframe_odometry = mapper.pose, odometry
        self._tracker.correct(self._pose)
        clock.lap("local map")
        self._statistics.add_keyframe(clock)
        self._statistics.merged_walls += merge is not None
        return Extension(view, merge, decision)

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
        self._reporter.tell(result)
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
            "loops": self._statistics.loop_counts(),
            "odometry_deviation_per_metre": self._odometry_noise.deviations.round(5).tolist(),
            "sigma_range": round(self._extractor.noise.sigma_range, 5),
            "wall_unevenness": round(math.sqrt(self._mapper.flatness.variance), 5),
            "timings": self._statistics.timings(),
            "health": self._statistics.health(),
        }
