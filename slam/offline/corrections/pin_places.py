"""What pins are about: keyframes and walls of a map, and their joint covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ...errors import MapError
from ...geometry.segments import Floats, Integers
from ...io.sessions import StoredSession
from ...io.sessions.corrections import Pin
from ...io.tum import Trajectory
from ...mapping.mapper import Mapper
from ...measuring.wall_map import WallMap
from .pinned_value import PinnedValue

MAX_TIME_DIFFERENCE = 0.5
"""Seconds between the stamp of a pinned pose and the nearest scan."""
UNMATCHED = np.diag(np.array([0.1, 0.1, 0.05]) ** -2.0)
"""Information (1/m^2, 1/m^2, 1/rad^2) of a scan's pose relative to its keyframe by odometry, some decimetres away."""


@immutable
class PinTarget:
    """What a pin is about.

    keyframe    to which a pinned pose is relative; None for a wall
    relative    (3,) pose in that keyframe's frame
    covariance  (3, 3) of `relative`, in its own frame
    """

    keyframe: int | None = None
    relative: se2.Pose = field(default_factory=lambda: np.zeros(3))
    covariance: Floats = field(default_factory=lambda: np.zeros((3, 3)))


class PinPlaces:
    """Poses of the robot at any stamp, relative to keyframes of the uncorrected map, which has converged."""

    def __init__(self, session: StoredSession, path: Trajectory) -> None:
        """Take a session, and the path in its results."""
        mapper = session.slam_state.mapper
        history = session.scan_history()
        self._stamps, self._informations = history.stamps, history.informations
        self._own_keyframes = history.own_keyframes
        self._stamp_as_read = session.stamp_as_read
        self._path, self._keyframe_poses = path, mapper.keyframe_poses.copy()
        self._keyframe_stamps = np.array(session.slam_state.keyframe_stamps)

    def target(self, pin: Pin) -> PinTarget:
        """Return what a pin is about. Raises MapError if there is no scan near its stamp."""
        if pin.kind == "wall":
            return PinTarget()
        stamp = self._stamp_as_read(pin.id)
        gaps = np.abs(self._stamps - stamp)
        row = int(gaps.argmin()) if len(gaps) else 0
        if not len(gaps) or gaps[row] > MAX_TIME_DIFFERENCE:
            raise MapError(f"{pin.name}: there is no scan within {MAX_TIME_DIFFERENCE} s of that stamp")
        keyframe = int(self._own_keyframes[row])
        relative = se2.between(self._keyframe_poses[keyframe], self._pose(stamp))
        if self._keyframe_stamps[keyframe] == self._stamps[row]:
            return PinTarget(keyframe, relative)
        return PinTarget(keyframe, relative, np.asarray(np.linalg.inv(self._informations[row] + UNMATCHED)))

    def _pose(self, stamp: float) -> se2.Pose:
        """Return the pose at a stamp, interpolated between those of the path."""
        stamps, poses = self._path.stamps, self._path.poses
        after = int(np.clip(np.searchsorted(stamps, stamp), 1, len(stamps) - 1))
        span = float(stamps[after] - stamps[after - 1])
        part = float(np.clip((stamp - stamps[after - 1]) / span, 0.0, 1.0)) if span else 0.0
        return se2.compose(poses[after - 1], part * se2.between(poses[after - 1], poses[after]))


class PinnedVariables:
    """Keyframes and walls that pins are about, and their joint covariance in the map."""

    def __init__(self, mapper: Mapper, wall_map: WallMap, pins: Sequence[Pin], targets: Sequence[PinTarget]) -> None:
        """Take a map that has converged. Raises MapError if it has no wall that a pin names."""
        keyframes = sorted({target.keyframe for target in targets if target.keyframe is not None})
        walls = sorted({int(wall_map.walls.identity[wall_map.row(int(p.id))]) for p in pins if p.kind == "wall"})
        self._frames = np.vstack([mapper.keyframe_poses[keyframes].reshape(-1, 3), mapper.graph.wall_frames(walls)])
        self._targets = targets
        self._rows = [
            len(keyframes) + walls.index(int(pin.id)) if target.keyframe is None else keyframes.index(target.keyframe)
            for pin, target in zip(pins, targets, strict=True)
        ]
        self._covariance = _joint_covariance(mapper, keyframes, walls, self._frames)

    def values(self, pins: Sequence[Pin]) -> list[PinnedValue]:
        """Return the pins with what the map has in their places."""
        result = []
        for pin, target, row in zip(pins, self._targets, self._rows, strict=True):
            heading = None if pin.heading is None or pin.sigma_heading is None else (pin.heading, pin.sigma_heading)
            covariance = np.array([[pin.xx, pin.xy], [pin.xy, pin.yy]])
            estimate = se2.compose(self._frames[row], target.relative)
            result.append(PinnedValue(np.array([pin.x, pin.y]), covariance, heading, estimate, target.keyframe is None))
        return result

    def covariance(self, values: Sequence[PinnedValue], motion: se2.Pose) -> Floats:
        """Return the joint covariance (m, m) of all m values in the map; `motion` takes the survey into the map."""
        size = sum(value.size for value in values)
        jacobian, noise, start = np.zeros((size, len(self._covariance))), np.zeros((size, size)), 0
        for value, target, row in zip(values, self._targets, self._rows, strict=True):
            part, columns = slice(start, start + value.size), slice(3 * row, 3 * row + 3)
            with_heading = value.heading is not None
            if value.is_wall:
                full = np.array([[0.0, 1.0, value.along(motion)], [0.0, 0.0, 1.0]])
                jacobian[part, columns] = full[: value.size]
            else:
                kept = slice(3 if with_heading else 2)
                turn = rotation(float(self._frames[row, 2]))
                jacobian[part, columns] = (turn @ _lever(target.relative))[kept]
                own = rotation(float(value.estimate[2]))
                noise[part, part] = (own @ target.covariance @ own.T)[kept, kept]
            start = part.stop
        return np.asarray(jacobian @ self._covariance @ jacobian.T + noise)


def _joint_covariance(mapper: Mapper, keyframes: Sequence[int], walls: Sequence[int], frames: Floats) -> Floats:
    """Return the joint covariance (3 n, 3 n) of poses and walls in the map, with correlated drift."""
    joint = mapper.graph.covariance_of(keyframes, walls).copy()
    first = mapper.landmarks.walls.rows["first_seen"][list(walls)]
    reached: Integers = np.array([*keyframes, *first], dtype=np.int64)
    turns = np.array([rotation(float(heading))[:2, :2] for heading in frames[:, 2]])
    shared = mapper.correlated_drift[np.minimum(reached[:, None], reached[None, :])]
    drift = np.einsum("iba,ijbc,jcd->ijad", turns, shared, turns)
    blocks = joint.reshape(len(reached), 3, len(reached), 3)
    blocks[:, :2, :, :2] += drift.transpose(0, 2, 1, 3)
    return joint


def rotation(heading: float) -> Floats:
    """Return the rotation (3, 3) of a small motion by a heading."""
    c, s = np.cos(heading), np.sin(heading)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _lever(relative: se2.Pose) -> Floats:
    """Return the matrix (3, 3) that takes a small motion of a keyframe to that of a pose fixed to it, in its axes."""
    x, y, _ = relative.tolist()
    return np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
