"""The story of a scan: measured, straightened, condensed into walls and corners, laid over the map, and made part of it."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Sequence

import numpy as np

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan
from features import Extractor, Noise

from .association import associate
from .config import Config
from .deskew import deskew
from .errors import MapError
from .events import Sink
from .local_map import empty_local_map
from .mapper import Mapper
from .odometry import OdometryHistory, motion_covariance
from .path import Path
from .registration import register
from .segments import Floats, corner_points, segments_from_lines

KEYFRAME_DISTANCE = 0.25  # metres
KEYFRAME_TURN = math.radians(8.0)
PREDICTION_SIGMAS = np.array([0.05, 0.05, math.radians(4.0)])  # added to the odometry's own: wheels slip, clocks differ


class Slam:
    """2-D SLAM: feed it messages in time order, read the pose, finish."""

    def __init__(self, config: Config | None = None, sinks: Sequence[Sink] = ()) -> None:
        self.config = config or Config()
        self._sinks = tuple(sinks)
        lidar = self.config.lidar
        self._extractor = Extractor(Noise(lidar.sigma_range, lidar.sigma_bearing))
        self._odometry = OdometryHistory()
        self._waiting: deque[Scan] = deque()
        self.mapper = Mapper()
        self._local_map = empty_local_map()
        self.path = Path()
        self.pose = np.zeros(3)
        self._last_odometry = np.zeros(3)
        self._keyframe_odometry = np.zeros(3)
        self._keyframe_pose = np.zeros(3)
        self.times: list[float] = []
        self.explained: list[float] = []

    def add(self, message: Message) -> None:
        match message:
            case Odometry():
                self._odometry.add(message)
            case Scan():
                self._waiting.append(message)
            case GroundTruth():
                pass
        while self._waiting and self._waiting[0].stamp + self._waiting[0].time_offsets[-1] <= self._odometry.latest:
            self._add_scan(self._waiting.popleft())

    def _add_scan(self, scan: Scan) -> None:
        started = time.perf_counter()
        odometry = self._odometry.at(scan.stamp)
        mount = scan.mount if scan.mount is not None else np.zeros(3)
        ranges, bearings = deskew(scan, self._odometry, mount)
        features = self._extractor.extract(ranges, bearings)
        segments = segments_from_lines(features.lines, mount)
        corners = corner_points(features.corners, segments, mount)

        first = self.mapper.keyframe_count == 0
        step = np.zeros(3) if first else se2.between(self._last_odometry, odometry)
        prediction = se2.compose(self.pose, step)
        prior = np.linalg.inv(motion_covariance(step, self.config.odometry) + np.diag(PREDICTION_SIGMAS**2))
        flatness = self.mapper.flatness.variance
        registration = register(prediction, prior, segments, corners, self._local_map, flatness)
        self.pose = registration.pose
        self._last_odometry = odometry
        self.explained.append(registration.explained)

        if first or self._moved_enough():
            covariance = np.linalg.inv(registration.information + prior)
            association = associate(self.pose, covariance, segments, corners, self._local_map, flatness)
            motion = se2.between(self._keyframe_odometry, odometry)
            view = self.mapper.add_keyframe(
                self.pose, None if first else (motion, motion_covariance(motion, self.config.odometry)),
                segments, corners, association, self._local_map,
            )
            self._local_map = self.mapper.refresh(view)
            self.pose = self._keyframe_pose = self.mapper.graph.keyframe_pose(self.mapper.keyframe_count - 1)
            self._keyframe_odometry = odometry
            self.times.append(time.perf_counter() - started)
        self.path.add(scan.stamp, self.mapper.keyframe_count - 1, se2.between(self._keyframe_pose, self.pose))

    def _moved_enough(self) -> bool:
        moved = se2.between(self._keyframe_pose, self.pose)
        return bool(np.hypot(moved[0], moved[1]) > KEYFRAME_DISTANCE or abs(moved[2]) > KEYFRAME_TURN)
