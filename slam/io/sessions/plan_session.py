"""A session made from a plan, on whose map a robot can localise as on that of an earlier run.

Each view of the plan takes the place of a keyframe at an exactly known pose.
"""

from __future__ import annotations

import numpy as np

from features import LearnedNoise

from ...config import Config
from ...estimation.slam_state import SlamState
from ...estimation.tracking_checkpoint import Anchor, TrackingCheckpoint
from ...geometry.segments import Floats
from ...graph.factor_graph import FIRST_POSE_SIGMAS
from ...localisation.local_field import REFERENCE_DISTANCE, LocalFieldState
from ...localisation.tracking import PoseFix, TrackerState
from ...loop_closure.loop_hypothesis import LoopAgreementState
from ...mapping.plan_map import VIEWS_END, PlanMap, PlanView
from ...mapping.plan_mapper import plan_mapper
from ...mapping.trajectory_builder import TrajectoryBuilder
from ...matching.scan_features import ScanFeatures
from ...matching.scan_points import ScanPoints
from ...odometry.history import OdometryHistory
from ...preprocessing.preprocessor import NO_FEATURES, ProcessedScan
from ..stored_session import StoredSession


def plan_session(plan_map: PlanMap, config: Config) -> StoredSession:
    """Return a session with the map of a plan, which ends before any recording begins. Raises MapError."""
    mapper, views = plan_mapper(plan_map), plan_map.views
    stamps = [VIEWS_END + 1.0 + k - len(views) for k in range(len(views))]
    scans = [_scan(stamp, view) for stamp, view in zip(stamps, views, strict=True)]
    trajectory = TrajectoryBuilder()
    for k, stamp in enumerate(stamps):
        trajectory.add(stamp, k, np.zeros(3), np.diag(FIRST_POSE_SIGMAS**-2.0))
    last = len(views) - 1
    state = SlamState.restored(
        config,
        np.zeros((0, 8)),
        mapper,
        trajectory,
        stamps,
        _checkpoint(scans[last], last, _links(np.array([view.position for view in views]))),
        LoopAgreementState(last_search=mapper.travelled[-1]),
        dict(enumerate(scans)),
    )
    poses = np.array([view.pose for view in views])
    history = OdometryHistory.from_arrays(np.array(stamps), poses)
    sigma_range, sigma_bearing = config.lidar.sigma_range, config.lidar.sigma_bearing
    return StoredSession(config, state, scans, [history], [0], LearnedNoise(sigma_range, sigma_bearing, sigma_range))


def _scan(stamp: float, view: PlanView) -> ProcessedScan:
    """Return a view as a scan; odometry has its pose in the plan."""
    features = ScanFeatures(view.segments, NO_FEATURES.corners, ScanPoints(view.points))
    return ProcessedScan(stamp, view.pose, features)


def _checkpoint(scan: ProcessedScan, keyframe: int, links: list[tuple[int, int]]) -> TrackingCheckpoint:
    """Return the state of tracking after the last view, which is that of a scan."""
    fix = PoseFix(scan.odometry, scan.reading)
    field = LocalFieldState(scan.odometry[:2], links, {}, (), np.zeros((0, 3)))
    anchor = Anchor(keyframe, np.zeros(3), np.zeros((3, 3)), scan.reading)
    return TrackingCheckpoint(TrackerState.placed(fix), field, anchor, False, ())


def _links(positions: Floats) -> list[tuple[int, int]]:
    """Return the pairs of views that are near each other and therefore show the same surfaces."""
    from scipy.spatial import cKDTree  # only here: it loads slowly

    pairs = cKDTree(positions).query_pairs(REFERENCE_DISTANCE, output_type="ndarray")
    pairs = pairs[pairs[:, 1] - pairs[:, 0] > 1]
    return [(first, second) for first, second in pairs[np.lexsort(pairs.T[::-1])].tolist()]
