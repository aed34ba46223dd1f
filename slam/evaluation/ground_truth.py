"""Compare an estimate with the ground truth of a simulation: normalised estimation errors squared (NEES).

The map frame is that of the first keyframe, so the true pose there transforms the world into the map. Mapped walls are
matched with true ones by geometry alone: if the covariances influenced the matching, the NEES would be biased.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import cast

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.immutable import immutable
from drivers.messages import Message
from drivers.simulation import Simulation, World

from ..config import Config
from ..events import Finished
from ..geometry.segments import Floats
from ..mapping.map_features import MapCorners, MapWalls
from ..pipeline import Slam
from .nees import line_nees, point_nees, pose_nees

MAX_LANDMARK_DISTANCE = 0.15  # metres between a mapped landmark and its true counterpart
MAX_ANGLE = np.radians(15.0)  # between a mapped and a true wall; the opposite side of a wall differs by 180 degrees
MIN_COVERED = 0.5  # share of a mapped wall's length that true walls must cover


RELATIVE_KEYFRAMES = 15  # keyframes between the two poses of a relative pose: some metres of driving


@immutable
class Nees:
    """NEES of k keyframes (3 degrees of freedom each), n walls and m corners (2 each) of one run.

    Keyframe 0 is left out, because it is exact by definition. Walls without a true counterpart, such as chords of a
    round table, and their corners have NaN.

    relative_poses  (r,) of the poses relative to the keyframe RELATIVE_KEYFRAMES before (3 degrees of freedom each)
    """

    poses: Floats
    walls: Floats
    corners: Floats
    relative_poses: Floats


def measure(
    simulation: Simulation,
    config: Config | None = None,
    *,
    messages: Iterable[Message] | None = None,
    straight: World | None = None,
) -> tuple[Nees, Finished]:
    """Run SLAM on a simulation and return the NEES and the result. Raises MapError if there is nothing to map.

    messages  of the simulation, after changes such as a defect of the recording; None for its own
    straight  world with the walls that are the truth; None for the simulation's own
    """
    slam = Slam(config)
    for message in simulation if messages is None else messages:
        slam.add(message)
    finished = slam.finish()
    truth, shifts = _true_poses(simulation, finished)
    sweeps = slam.session.scan_history().sweep_covariances
    covariances = (
        finished.keyframes.covariance
        + np.einsum("ki,kj->kij", shifts, shifts)
        + _moved(sweeps[0], se2.between(truth, truth[0]))
    )
    walls = true_walls(simulation.world if straight is None else straight, truth[0])
    return Nees(
        poses=pose_nees(finished.keyframes.poses[1:], covariances[1:], se2.between(truth[0], truth[1:])),
        walls=wall_nees(finished.walls, walls),
        corners=corner_nees(finished.corners, finished.walls, walls),
        relative_poses=_relative_pose_nees(slam, finished, truth, shifts, sweeps),
    ), finished


def _true_poses(simulation: Simulation, finished: Finished) -> tuple[Floats, Floats]:
    """Return the true poses (k, 3) of the keyframes when they were measured, and one sigma of that time as motions.

    The stamps of the keyframes are on the lidar's clock. A significant delay is corrected, as estimated. The motions
    (k, 3) are relative to that of the first keyframe, which defines the map, each in its keyframe's frame.
    """
    delay = cast("dict[str, float] | None", finished.summary["scan_delay"])
    seconds, sigma = (delay["seconds"], delay["sigma"]) if delay and delay["significant"] else (0.0, 0.0)
    before, truth, after = (
        simulation.trajectory.poses_at(finished.keyframes.stamps - seconds + step * sigma) for step in (-0.5, 0.0, 0.5)
    )
    shifts = se2.between(before, after)
    return truth, shifts - np.einsum("kij,j->ki", se2.adjoint(se2.between(truth, truth[0])), shifts[0])


def _moved(covariances: Floats, poses: Floats) -> Floats:
    """Return covariances (..., 3, 3) of displacements in frames at `poses` (..., 3) as those of the base there."""
    adjoint = se2.adjoint(poses)
    return np.asarray(adjoint @ covariances @ adjoint.swapaxes(-1, -2))


def _relative_pose_nees(slam: Slam, finished: Finished, truth: Floats, shifts: Floats, sweeps: Floats) -> Floats:
    """Return the NEES (r,) of poses relative to an earlier keyframe.

    truth, shifts  (k, 3) the true poses of the keyframes, and the uncertainty of their time
    sweeps         (k, 3, 3) their sweep covariances, see `ScanFeatures`
    """
    first = np.arange(0, len(truth) - RELATIVE_KEYFRAMES)
    second = first + RELATIVE_KEYFRAMES
    if not len(first):
        return np.zeros(0)
    mapper, estimate = slam.slam_state.mapper, finished.keyframes.poses
    pairs = zip(first.tolist(), second.tolist(), strict=True)
    covariances = np.array([mapper.covariances.relative(*pair) for pair in pairs])
    relative, true = (se2.between(poses[first], poses[second]) for poses in (estimate, truth))
    covariances = covariances + sweeps[second] + _moved(sweeps[first], se2.inverse(true))
    moved = shifts[second] - np.einsum("kij,kj->ki", se2.adjoint(se2.inverse(true)), shifts[first])
    return pose_nees(relative, covariances + np.einsum("ki,kj->kij", moved, moved), true)


@immutable
class TrueWalls:
    """Sides of n true walls in the map frame: frame (n, 3) at one end, x along the wall; length (n,) in metres."""

    frame: Floats
    length: Floats


def true_walls(world: World, origin: se2.Pose) -> TrueWalls:
    """Return both sides of each segment of a world in the map frame; `origin` is the map's pose in the world."""
    ends = world.segments.reshape(-1, 2, 2)
    ends = np.concatenate([ends, ends[:, ::-1]])
    along = ends[:, 1] - ends[:, 0]
    frame = np.column_stack([ends[:, 0], np.arctan2(along[:, 1], along[:, 0])])
    return TrueWalls(se2.between(origin, frame), np.hypot(along[:, 0], along[:, 1]))


def match_walls(mapped: MapWalls, walls: TrueWalls) -> NDArray[np.int64]:
    """Return the index (n,) of the true wall nearest to both ends of each mapped one; -1 if none is near.

    A mapped wall continues behind doors, so its overlap with all true walls on one line is added up.
    """
    ends = mapped.end_points()
    relative = se2.transform(se2.inverse(walls.frame)[:, None, None], ends[None])  # (true, mapped, end, xy)
    angle = se2.wrap(mapped.frame[None, :, 2] - walls.frame[:, None, 2])
    distance = np.abs(relative[..., 1]).max(axis=-1)
    covered = np.minimum(relative[:, :, 1, 0], walls.length[:, None]) - np.maximum(relative[:, :, 0, 0], 0.0)
    _, line = np.unique(np.round(_line_coordinates(walls.frame), 6), axis=0, return_inverse=True)
    on_line = np.zeros((line.max() + 1, len(mapped)))
    np.add.at(on_line, line.ravel(), np.maximum(covered, 0.0))
    enough = (on_line[line.ravel()] > MIN_COVERED * (mapped.high - mapped.low)) & (covered > 0.0)
    distance[~enough | (np.abs(angle) > MAX_ANGLE) | (distance > MAX_LANDMARK_DISTANCE)] = np.inf
    nearest = distance.argmin(axis=0)
    return np.where(np.isfinite(distance[nearest, np.arange(len(mapped))]), nearest, -1)


def _line_coordinates(frames: Floats) -> Floats:
    """Return coordinates (n, 3) of the x axes of frames, equal if the axes have the same line and direction."""
    c, s = np.cos(frames[:, 2]), np.sin(frames[:, 2])
    return np.column_stack([c, s, c * frames[:, 1] - s * frames[:, 0]])


def wall_nees(mapped: MapWalls, walls: TrueWalls) -> Floats:
    """Return the NEES (n,) of offset and heading of mapped walls, NaN for those without a true wall."""
    match = match_walls(mapped, walls)
    found = match >= 0
    result = np.full(len(mapped), np.nan)
    result[found] = line_nees(mapped.frame[found], mapped.covariance[found], walls.frame[match[found]])
    return result


def corner_nees(corners: MapCorners, mapped: MapWalls, walls: TrueWalls) -> Floats:
    """Return the NEES (m,) of mapped corners against the intersection of their two true walls.

    NaN if one of the walls is not in the map or has no true counterpart, or if the corner is far from the intersection.
    """
    match = np.append(match_walls(mapped, walls), -1)
    row_of = {int(identity): row for row, identity in enumerate(mapped.identity)}
    rows = np.array([[row_of.get(int(wall), -1) for wall in pair] for pair in corners.walls], dtype=np.int64)
    rows = rows.reshape(-1, 2)
    first, second = match[rows].T
    known = np.flatnonzero((first >= 0) & (second >= 0))
    result = np.full(len(corners), np.nan)
    truth = _intersections(walls.frame[first[known]], walls.frame[second[known]])
    near = np.hypot(*(corners.position[known] - truth).T) < MAX_LANDMARK_DISTANCE
    known, truth = known[near], truth[near]
    result[known] = point_nees(corners.position[known], corners.covariance[known], truth)
    return result


def _intersections(first: Floats, second: Floats) -> Floats:
    """Return the intersections (n, 2) of the x axes of frames (n, 3); not finite if they are parallel."""
    relative = se2.between(first, second)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = relative[:, 0] - relative[:, 1] / np.tan(relative[:, 2])
    return se2.transform(first, np.column_stack([along, np.zeros(len(first))]))
