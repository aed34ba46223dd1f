"""What a simulation knows to be true, laid beside what was estimated: errors in units of the covariances (NEES).

The map's frame is that of the first keyframe, so the true pose there takes the world into the map. Which true wall a
mapped one shows is decided by geometry alone: if the covariances had a say, they would be judged by what they chose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.messages import GroundTruth
from drivers.simulation import Simulation, World

from ..config import Config
from ..events import Finished, MapCorners, MapWalls
from ..io.tum import Trajectory
from ..pipeline import Slam
from .nees import Floats, line_nees, point_nees, pose_nees

FARTHEST = 0.15  # metres between a mapped thing and the true one it is taken for
WIDEST = np.radians(15.0)  # the same, of direction; the other face of a wall runs the opposite way
LEAST_COVERED = 0.5  # of a mapped wall that true walls must cover


@dataclass(frozen=True, slots=True, eq=False)
class Nees:
    """NEES of k keyframes (3 degrees of freedom each), n walls and m corners (2 each) of one run.

    Keyframe 0 is left out: it is true by definition. NaN stands for walls that are nothing straight in the world, such
    as those on a round table, and for corners of such.
    """

    poses: Floats
    walls: Floats
    corners: Floats


def measure(simulation: Simulation, config: Config | None = None) -> tuple[Nees, Finished]:
    """Run SLAM over a simulation and compare."""
    slam = Slam(config)
    truth: list[GroundTruth] = []
    for message in simulation:
        slam.add(message)
        if isinstance(message, GroundTruth):
            truth.append(message)
    finished = slam.finish()
    covariances = np.array([slam.keyframe_covariance(k) for k in range(len(finished.keyframes))])
    true_path = Trajectory(np.array([t.stamp for t in truth]), np.array([t.pose for t in truth]))
    return compare(finished, covariances, simulation.world, true_path), finished


def compare(finished: Finished, covariances: Floats, world: World, truth: Trajectory) -> Nees:
    """NEES of a run's keyframes, with their covariances (k, 3, 3) each in the keyframe's own frame, and of its map."""
    true_poses = truth.at(finished.keyframe_stamps).poses
    in_map = se2.between(true_poses[0], true_poses)
    walls = true_walls(world, true_poses[0])
    return Nees(
        poses=pose_nees(finished.keyframes[1:], covariances[1:], in_map[1:]),
        walls=wall_nees(finished.lines, walls),
        corners=corner_nees(finished.corners, finished.lines, walls),
    )


@dataclass(frozen=True, slots=True, eq=False)
class TrueWalls:
    """n sides of walls in the map's frame: frame (n, 3) at one end, x along the wall, and length (n,) in metres."""

    frame: Floats
    length: Floats


def true_walls(world: World, origin: se2.Pose) -> TrueWalls:
    """A world's segments, both sides of each, seen from the map's `origin` in the world."""
    ends = world.segments.reshape(-1, 2, 2)
    ends = np.concatenate([ends, ends[:, ::-1]])
    along = ends[:, 1] - ends[:, 0]
    frame = np.column_stack([ends[:, 0], np.arctan2(along[:, 1], along[:, 0])])
    return TrueWalls(se2.between(origin, frame), np.hypot(along[:, 0], along[:, 1]))


def match_walls(lines: MapWalls, walls: TrueWalls) -> NDArray[np.int64]:
    """(n,) index of the true wall that lies nearest to both ends of each mapped one; -1 where none is near.

    A mapped wall goes on behind doors, so what it covers of all true walls on one line counts together.
    """
    ends = lines.end_points()
    seen = se2.transform(se2.inverse(walls.frame)[:, None, None], ends[None])  # (true, mapped, end, xy)
    turn = se2.wrap(lines.frame[None, :, 2] - walls.frame[:, None, 2])
    distance = np.abs(seen[..., 1]).max(axis=-1)
    covered = np.minimum(seen[:, :, 1, 0], walls.length[:, None]) - np.maximum(seen[:, :, 0, 0], 0.0)
    _, line = np.unique(np.round(_line_coordinates(walls.frame), 6), axis=0, return_inverse=True)
    on_line = np.zeros((line.max() + 1, len(lines)))
    np.add.at(on_line, line.ravel(), np.maximum(covered, 0.0))
    enough = (on_line[line.ravel()] > LEAST_COVERED * (lines.high - lines.low)) & (covered > 0.0)
    distance[~enough | (np.abs(turn) > WIDEST) | (distance > FARTHEST)] = np.inf
    nearest = distance.argmin(axis=0)
    return np.where(np.isfinite(distance[nearest, np.arange(len(lines))]), nearest, -1)


def _line_coordinates(frames: Floats) -> Floats:
    """(n, 3): the same for frames with their x axes on one line, in one direction."""
    c, s = np.cos(frames[:, 2]), np.sin(frames[:, 2])
    return np.column_stack([c, s, c * frames[:, 1] - s * frames[:, 0]])


def wall_nees(lines: MapWalls, walls: TrueWalls) -> Floats:
    """(n,) NEES of offset and heading of mapped walls, NaN for those that are none."""
    match = match_walls(lines, walls)
    found = match >= 0
    result = np.full(len(lines), np.nan)
    result[found] = line_nees(lines.frame[found], lines.covariance[found], walls.frame[match[found]])
    return result


def corner_nees(corners: MapCorners, lines: MapWalls, walls: TrueWalls) -> Floats:
    """(m,) NEES of mapped corners against where the lines of their two true walls meet.

    NaN where one of its walls is not in the map, or nothing true, or where the corner is far from that point.
    """
    match = np.append(match_walls(lines, walls), -1)
    row_of = {int(identity): row for row, identity in enumerate(lines.identity)}
    rows = np.array([[row_of.get(int(wall), -1) for wall in pair] for pair in corners.lines]).reshape(-1, 2)
    first, second = match[rows].T
    known = np.flatnonzero((first >= 0) & (second >= 0))
    result = np.full(len(corners), np.nan)
    truth = _meeting(walls.frame[first[known]], walls.frame[second[known]])
    near = np.hypot(*(corners.position[known] - truth).T) < FARTHEST
    known, truth = known[near], truth[near]
    result[known] = point_nees(corners.position[known], corners.covariance[known], truth)
    return result


def _meeting(first: Floats, second: Floats) -> Floats:
    """(n, 2): where the x axes of frames (n, 3) meet; infinitely far or not a number where they are parallel."""
    seen = se2.between(first, second)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = seen[:, 0] - seen[:, 1] / np.tan(seen[:, 2])
    return se2.transform(first, np.column_stack([along, np.zeros(len(first))]))
