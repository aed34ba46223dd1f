"""Compilation of all numba functions before a run, so that no scan is delayed by it.

Compiled functions are cached on disk: only the first run after an installation or a change compiles, later runs load
them. Without a warm-up only the first scans take longer.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from drivers import se2
from drivers.messages import Floats, Message, Odometry, Scan

from .geometry.segments import Segments
from .loop_closure.occlusion import REFERENCE_DISTANCE, occluded_share, old_walls
from .loop_closure.relocalisation import index_map, relocalise, submap_of
from .loop_closure.submap_search import build_submap, search_submap
from .mapping.landmarks import Landmarks
from .mapping.unconfirmed_observations import CONFIRMING_KEYFRAMES
from .mapping.wall_removal import FreeSpaceEvidence
from .pipeline import Slam

ROOM = 4.0, 3.0
"""Length and width of the simulated room, metres."""
BEAMS = 180
WARMUP_SCANS = 20
STEP = 0.1
"""Distance between scans, metres."""
INTERVAL = 0.1
"""Time between scans, seconds."""


def warm_up() -> None:
    """Compile, or load from disk, everything that a run with default settings calls."""
    slam = Slam()
    for message in _drive():
        slam.add(message)
    mapper = slam.slam_state.mapper
    relocalise(submap_of(mapper), index_map(mapper))
    _check_loop([(mapper.graph.keyframe_pose(keyframe), segments) for keyframe, segments in mapper.recent_segments])
    _update_free_space()
    _search_submap()
    slam.finish()


def _drive() -> Iterator[Message]:
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


def _check_loop(views: Sequence[tuple[se2.Pose, Segments]]) -> None:
    """Check a loop closure in a room that was mapped long ago and is observed again."""
    landmarks = Landmarks()
    sides = np.array([[0.0, -1.5, 0.0], [2.0, 0.0, np.pi / 2], [0.0, 1.5, np.pi], [-2.0, 0.0, -np.pi / 2]])
    for keyframe in (0, 2):
        for side in sides:
            wall = landmarks.add_wall(side, 1.4, keyframe)
            landmarks.observe_wall(wall, side, 1.4, keyframe + 1)
    landmarks.confirm_observed(CONFIRMING_KEYFRAMES)
    travelled = np.array([0.0, 0.0, 2 * REFERENCE_DISTANCE, 2 * REFERENCE_DISTANCE])
    old = old_walls(landmarks, np.zeros(3), travelled, np.inf)
    occluded_share(np.zeros(3), old, landmarks, views)


def _update_free_space() -> None:
    """Update free-space evidence with a point behind a wall."""
    landmarks = Landmarks()
    landmarks.add_wall(np.zeros(3), 1.0, 0)
    FreeSpaceEvidence().update(landmarks, np.array([0.0, -1.0, 0.0]), np.array([[0.0, 2.0]]), [0.0], [np.zeros((3, 3))])


def _search_submap() -> None:
    """Search the submap of two walls in itself."""
    along = np.linspace(0.0, 2.0, 30)
    ones, zeros = np.ones(30), np.zeros(30)
    walls = [np.column_stack([along, -ones, zeros, ones]), np.column_stack([ones, along, -ones, zeros])]
    submap = build_submap(np.zeros((1, 3)), [np.concatenate(walls)], 5.0)
    search_submap(submap, submap, np.zeros(3), 0.3, 0.1)
