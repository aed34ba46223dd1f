"""Compile everything before it is needed: a live scan must not wait for a compiler.

Compiled functions are kept on disk, so that only the first run after an installation or a change compiles; later ones
load them. Nothing breaks without a warm-up, the first scans just take longer.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from drivers import se2
from drivers.messages import Floats, Message, Odometry, Scan

from .geometry.segments import Segments
from .loop_closure.proposal import propose
from .loop_closure.recent_walls import OLD_WAY, recent_and_reference
from .loop_closure.relocalisation import index_map, relocalise, submap_of
from .loop_closure.verification import contradiction
from .mapping.landmarks import Landmarks
from .mapping.wall_removal import FreeSpaceEvidence
from .pipeline import Slam

ROOM = 4.0, 3.0  # metres
BEAMS = 180
SCANS = 20
STEP = 0.1  # metres between scans
INTERVAL = 0.1  # seconds between scans


def warm_up() -> None:
    """Compile, or load from disk, all that a run with the default settings calls."""
    slam = Slam()
    for message in _drive():
        slam.add(message)
    mapper = slam.slam_state.mapper
    relocalise(submap_of(mapper), index_map(mapper))
    _find_loop([(mapper.graph.keyframe_pose(keyframe), seen) for keyframe, seen in mapper.views])
    _see_through()
    slam.finish()


def _drive() -> Iterator[Message]:
    """A robot that drives through a small room and sees a box on its way."""
    angles = 2 * np.pi * ((np.arange(BEAMS) + 0.5) / BEAMS - 0.5)  # along no axis, where a distance would be infinite
    offsets = np.linspace(0.0, 0.5 * INTERVAL, BEAMS)
    random = np.random.default_rng(0)
    for k in range(SCANS):
        pose = np.array([-1.0 + STEP * k, 0.3, 0.011 * k])
        yield Odometry(INTERVAL * k, pose)
        yield Scan(INTERVAL * k, _ranges(pose, angles) + random.normal(0.0, 0.01, BEAMS), angles, offsets, 0.1, 30.0)
    yield Odometry(INTERVAL * SCANS, pose)


def _ranges(pose: se2.Pose, angles: Floats) -> Floats:
    """Distances (n,) to the walls of the room around the map's origin, and to a little of something in its middle."""
    c, s = np.cos(angles + pose[2]), np.sin(angles + pose[2])
    to_sides = (np.sign(c) * ROOM[0] / 2 - pose[0]) / c
    to_ends = (np.sign(s) * ROOM[1] / 2 - pose[1]) / s
    ranges = np.minimum(to_sides, to_ends)
    ranges[::9] *= 0.7  # points on no wall
    return np.asarray(ranges, dtype=np.float64)


def _find_loop(views: Sequence[tuple[se2.Pose, Segments]]) -> None:
    """A room that was seen long ago and is seen again."""
    landmarks = Landmarks()
    sides = np.array([[0.0, -1.5, 0.0], [2.0, 0.0, np.pi / 2], [0.0, 1.5, np.pi], [-2.0, 0.0, -np.pi / 2]])
    for keyframe in (0, 1):
        for side in sides:
            wall = landmarks.add_wall(side, 1.4, keyframe)
            landmarks.walls.rows["in_graph"][wall] = True
            landmarks.walls.rows["observations"][wall] = 2
    recent, old = recent_and_reference(landmarks, np.zeros(3), np.array([0.0, 2 * OLD_WAY]))
    propose(recent, old, np.zeros(3))
    contradiction(np.zeros(3), old, landmarks, views)


def _see_through() -> None:
    """A wall with a point behind it."""
    landmarks = Landmarks()
    landmarks.add_wall(np.zeros(3), 1.0, 0)
    FreeSpaceEvidence().update(landmarks, np.array([0.0, -1.0, 0.0]), np.array([[0.0, 2.0]]), [0.0], [np.zeros((3, 3))])
