"""Compilation of all numba functions before a run, so that no scan is delayed by it.

Compiled functions are in the wheel or cached on disk: only the first run after an installation from source or a change
compiles, others load them. Without a warm-up only the first scans take longer. The first compilation runs in two
processes, each with a part of the functions; what one of them has compiled, the other one loads.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from drivers import se2
from drivers.messages import Odometry, Scan
from drivers.simulation import warm_up as warm_up_simulation
from drivers.timing.floor import warm_up as warm_up_floor
from drivers.timing.own_returns import warm_up as warm_up_own_returns
from drivers.timing.scan_matching import warm_up as warm_up_timing

from .checks.adapter import drive_of
from .checks.leave_out_map import LeaveOutMap
from .checks.report import find_suspects
from .config import Config
from .estimation.estimator import Estimator
from .estimation.map_view import final_result
from .estimation.refinement import build_scan_history, match_trajectory
from .estimation.slam_state import SlamState
from .geometry.segments import CornerPoints, Floats, Segments
from .io.exports.occupancy import OccupancyGrid
from .io.exports.scan_placement import PlacedScan
from .localisation.small_objects import SmallObjects
from .localisation.view_change import View
from .loop_closure.occlusion import OLD_DISTANCE, occluded_share, old_walls
from .loop_closure.submap_search import build_submap, search_submap
from .mapping.convergence import converge
from .mapping.landmarks import Landmarks
from .mapping.odometry_segments import OdometrySegments
from .mapping.unconfirmed_observations import CONFIRMING_KEYFRAMES
from .mapping.wall_removal import FreeSpaceEvidence
from .matching.distance_field import DistanceField
from .matching.point_costs import excess_cost
from .matching.point_matcher import Prediction, match_points
from .matching.scan_features import ScanFeatures
from .matching.scan_points import ScanPoints
from .odometry.error_model import OdometryModel
from .pipeline import Slam
from .preprocessing.extraction import is_compiled
from .preprocessing.preprocessor import Preprocessor, ProcessedScan
from .recognition.drive_scans import DriveScans
from .recognition.evidence import compare_cells
from .recognition.location import LOST, locate
from .recognition.map_index import index_map
from .recognition.placements import Placement
from .recognition.scanned_map import scan_map

ROOM = 4.0, 3.0
"""Length and width of the simulated room, metres."""
SIDES = np.array([[0.0, -1.5, 0.0], [2.0, 0.0, np.pi / 2], [0.0, 1.5, np.pi], [-2.0, 0.0, -np.pi / 2]])
"""Frames of its walls, as seen from inside."""
BEAMS = 180
WARMUP_SCANS = 20
STEP = 0.1
"""Distance between scans, metres."""
INTERVAL = 0.1
"""Time between scans, seconds."""
CONFIG = Config.model_validate({"mapping": {"keyframe_distance": 3 * STEP}})
"""Default settings, with so many keyframes that a drive through a small room calls everything."""

COMPILATION = """
import gc, os
from slam.cli import COLLECTION_THRESHOLD
gc.set_threshold(COLLECTION_THRESHOLD)
os.environ["NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING"] = "1"  # numba colours messages that nobody sees
from slam.warmup import {0}
{0}()
"""
"""Program of a process that compiles."""


def warm_up() -> None:
    """Compile, or load from disk, everything that a run with default settings calls; online, call it before the drive.

    Takes up to a minute after an installation from source, otherwise a few seconds.
    """
    if not is_compiled():
        _compile_in_processes((compile_preprocessing, compile_estimation))
    slam = Slam(CONFIG)
    for message in _drive():
        slam.add(message)
    _recognise(slam.slam_state)
    _check_loop(slam.slam_state)
    slam.slam_state.mapper.graph.residuals()  # for the review log
    _update_free_space()
    _search_submap()
    _search_poses()
    _count_person()
    _refit_scan()
    _draw_grid()
    slam.finish()


def _compile_in_processes(parts: Sequence[Callable[[], None]]) -> None:
    """Call functions of this module at the same time, each in a process; they are ended with this one."""
    processes = []
    try:
        for part in parts:
            processes.append(subprocess.Popen([sys.executable, "-c", COMPILATION.format(part.__name__)]))
        for process in processes:
            process.wait()
    finally:  # also if a signal ends the command: they would keep the processors and the terminal for a minute
        for process in processes:
            process.kill()
            process.wait()


def compile_preprocessing() -> None:
    """Compile what makes features of scans, the search for loops, and what only some commands call: maps as images,
    simulations, and the timing of recordings."""
    preprocessor = Preprocessor(Config())
    for message in _drive():
        preprocessor.add(message)
        while (scan := preprocessor.next_scan()) is not None:
            preprocessor.process(scan, OdometryModel(Config().odometry))
    _search_submap()
    _update_free_space()
    _search_poses()
    _count_person()
    _refit_scan()
    _draw_grid()
    warm_up_simulation()
    warm_up_timing()
    warm_up_floor()
    warm_up_own_returns()


def compile_estimation() -> None:
    """Compile what estimates path and map from features, which are made up here."""
    state = SlamState(CONFIG)
    estimator, scans = Estimator(state), []
    for message in _drive():
        if isinstance(message, Odometry):
            state.dead_reckoning.history.add(message)
            odometry = message.pose
        else:
            scans.append(_seen_features(message, odometry))
            estimator.process(scans[-1])
    state = estimator.state
    _recognise(state)
    _check_loop(state)
    state.mapper.graph.residuals()
    converge(state.mapper)
    history = build_scan_history(scans, state.trajectory, state.keyframe_stamps, [state.dead_reckoning.history])
    path_distances = state.local_field.path_distances(state.mapper.travelled)
    state.trajectory = match_trajectory(state.mapper, history, state.odometry_model, path_distances)
    placed = state.trajectory.at_scans(state.mapper.keyframe_poses)
    find_suspects(drive_of(scans, OdometrySegments(starts=[0]), placed, state.odometry_model, 0.0))
    final_result(state, placed, history.sweep_covariances, {})


def _seen_features(scan: Scan, pose: se2.Pose) -> ProcessedScan:
    """Return the features of a scan of the room, taken at `pose`."""
    frames = se2.between(pose, SIDES)
    half_lengths = np.array([ROOM[0], ROOM[1], ROOM[0], ROOM[1]]) / 2.0
    segments = Segments(frames, half_lengths - 0.1, np.tile(np.diag([1e-5, 1e-5]), (4, 1, 1)))
    pairs = np.column_stack([np.arange(4), (np.arange(4) + 1) % 4])
    positions = 0.5 * np.array([[ROOM[0], -ROOM[1]], [ROOM[0], ROOM[1]], [-ROOM[0], ROOM[1]], [-ROOM[0], -ROOM[1]]])
    corners = CornerPoints(
        se2.transform(se2.inverse(pose), positions), np.tile(1e-4 * np.eye(2), (4, 1, 1)), pairs, frames[pairs, 2]
    )
    points = np.column_stack([scan.ranges * np.cos(scan.angles), scan.ranges * np.sin(scan.angles)])
    return ProcessedScan(scan.stamp, pose, ScanFeatures(segments, corners, ScanPoints(points)), 0.01)


def _drive() -> Iterator[Odometry | Scan]:
    """Yield the messages of a robot that drives through a small room with an object in it."""
    # no beam is parallel to a wall, where a distance would be infinite
    angles = 2 * np.pi * ((np.arange(BEAMS) + 0.5) / BEAMS - 0.5)
    offsets = np.linspace(0.0, 0.5 * INTERVAL, BEAMS)
    random = np.random.default_rng(0)
    for k in range(WARMUP_SCANS):
        pose = np.array([-1.0 + STEP * k, 0.3, 0.011 * k])
        yield Odometry(INTERVAL * k, pose)
        yield Scan(INTERVAL * k, _ranges(pose, angles) + random.normal(0.0, 0.01, BEAMS), angles, offsets, 0.1, 30.0)
    yield Odometry(INTERVAL * WARMUP_SCANS, pose)


def _ranges(pose: se2.Pose, angles: Floats) -> Floats:
    """Return the ranges (n,) to the walls of a room around the map's origin, with some shorter returns between them."""
    c, s = np.cos(angles + pose[2]), np.sin(angles + pose[2])
    to_sides = (np.sign(c) * ROOM[0] / 2 - pose[0]) / c
    to_ends = (np.sign(s) * ROOM[1] / 2 - pose[1]) / s
    ranges = np.minimum(to_sides, to_ends)
    ranges[::9] *= 0.7
    return np.asarray(ranges, dtype=np.float64)


def _check_loop(state: SlamState) -> None:
    """Check a loop closure in a room that was mapped long ago and is observed again."""
    mapper, landmarks = state.mapper, Landmarks()
    views = [(mapper.graph.keyframe_pose(keyframe), segments) for keyframe, segments in mapper.recent_segments]
    for keyframe in (0, 2):
        for side in SIDES:
            wall = landmarks.add_wall(side, 1.4, keyframe)
            landmarks.observe_wall(wall, side, 1.4, keyframe + 1)
    landmarks.confirm_observed(CONFIRMING_KEYFRAMES)
    travelled = np.array([0.0, 0.0, 2 * OLD_DISTANCE, 2 * OLD_DISTANCE])
    old = old_walls(landmarks, np.zeros(3), travelled, np.inf)
    occluded_share(np.zeros(3), old, landmarks, views)


def _recognise(state: SlamState) -> None:
    """Search for a drive in its own map."""
    mapper, rows = state.mapper, np.arange(state.mapper.keyframe_count)
    index, points = index_map(mapper), state.local_field.points_of(rows)
    known, drive = scan_map(index, mapper.keyframe_poses, points), DriveScans().take(mapper, state.local_field, 0)
    locate(drive, known, LOST)
    alone = Placement(np.array([submap.pose for submap in drive.submaps]), np.zeros((len(drive.submaps), 3, 3)), 0.0)
    compare_cells(drive, known, alone)


def _update_free_space() -> None:
    """Update free-space evidence with a point behind a wall."""
    landmarks = Landmarks()
    landmarks.add_wall(np.zeros(3), 1.0, 0)
    FreeSpaceEvidence().update(
        landmarks, np.array([0.0, -1.0, 0.0]), np.array([[0.0, 2.0]]), [0.0], np.zeros((1, 3, 3))
    )


def _refit_scan() -> None:
    """Compare a scan with a map of others, as the checks do if enough scans are there."""
    others, points = LeaveOutMap(np.zeros((1, 2))), np.array([[1.0, 0.0, -1.0, 0.0, 0.0, 1.0]])
    others.add(points, np.zeros(3))
    around = others.around(np.zeros(2), 1.0)
    around.gains(points, around.likelihoods(points, np.zeros(3)), np.zeros((1, 3)))


def _draw_grid() -> None:
    """Draw an occupancy grid with one point."""
    grid = OccupancyGrid(0.05)
    grid.add(PlacedScan(0.0, np.zeros(2), np.ones((1, 2))))
    grid.occupancy()


def _search_submap() -> None:
    """Search the submap of two walls in itself."""
    submap = build_submap(np.zeros((1, 3)), [_two_walls()], 5.0)
    search_submap(submap, submap, np.zeros(3), 0.3, 0.1)


def _search_poses() -> None:
    """Search for a robot that may be elsewhere, and compare two views, with points of two walls."""
    points, field = _two_walls(), DistanceField.empty(np.zeros(2))
    field.insert(np.zeros(3), points)
    match_points(field, points, [Prediction(np.zeros(3), np.diag([100.0, 100.0, 1e3]))], exhaustive=True)
    view = View(Odometry(0.0, np.zeros(3)), np.ascontiguousarray(points[:, :2]))
    view.differs_from(view, np.zeros(3))


def _count_person() -> None:
    """Count a person as a small object that has moved."""
    angles = np.linspace(0.5 * np.pi, 1.5 * np.pi, 20)
    person = np.array([1.0, 0.5]) + 0.2 * np.column_stack([np.cos(angles), np.sin(angles)])
    nothing = np.zeros((0, 2))
    no_corners = CornerPoints(nothing, np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=np.int64), nothing)
    no_segments = Segments(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2)))
    scan, field, objects = (
        ScanFeatures(no_segments, no_corners, ScanPoints(person)),
        DistanceField.empty(np.zeros(2)),
        SmallObjects(),
    )
    points = objects.weighted_points(scan)
    field.insert(np.zeros(3), points)
    excess_cost(field.arrays, points, np.zeros(3), np.zeros(3))
    objects.add(scan, np.zeros(3), field, 1.0)


def _two_walls() -> Floats:
    """Return (p, 6) points with normals on two walls."""
    along = np.linspace(0.0, 2.0, 30)
    ones, zeros = np.ones(30), np.zeros(30)
    walls = [
        np.column_stack([along, -ones, zeros, ones, ones, ones]),
        np.column_stack([ones, along, -ones, zeros, ones, ones]),
    ]
    return np.concatenate(walls)
