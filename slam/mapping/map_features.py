"""Walls, corners and keyframes of the map as plain data."""

from __future__ import annotations

import numpy as np

from drivers.immutable import immutable

from ..formatting import counted
from ..geometry.segments import Floats, Integers


@immutable
class MapWalls:
    """n walls of the map.

    identity      (n,) landmark ids, which never change
    frame         (n, 3) in the map: x along the wall, which is seen from y > 0
    low, high     (n,) metres along x: observed extent
    observations  (n,) number of keyframes
    covariance    (n, 2, 2) of the offset across the wall (metres) and its heading (radians) at the frame's origin; NaN
                  if it was not requested
    pieces        one array (k, 2) per wall: begin and end of its observed stretches along x, metres; there may be
                  openings between them
    """

    identity: Integers
    frame: Floats
    low: Floats
    high: Floats
    observations: Integers
    covariance: Floats
    pieces: tuple[Floats, ...]

    def __len__(self) -> int:
        return len(self.frame)

    def __repr__(self) -> str:
        return f"<MapWalls: {counted(len(self), 'wall')}>"

    def end_points(self) -> Floats:
        """Return both end points (n, 2, 2) of each wall in the map, metres."""
        return _along(self.frame, np.stack([self.low, self.high], axis=-1))

    def piece_points(self) -> tuple[Floats, Integers]:
        """Return both end points (m, 2, 2) of each piece in the map, metres, and the row (m,) of its wall."""
        wall = np.repeat(np.arange(len(self)), [len(pieces) for pieces in self.pieces])
        return _along(self.frame[wall], np.concatenate([np.zeros((0, 2)), *self.pieces])), wall

    def piece_points_of(self, row: int) -> Floats:
        """Return both end points (k, 2, 2) of each piece of one wall (row) in the map, metres."""
        pieces = self.pieces[row]
        return _along(np.tile(self.frame[row], (len(pieces), 1)), pieces)


def _along(frame: Floats, extent: Floats) -> Floats:
    """Return the points (n, 2, 2) at two distances (n, 2) along the x axes of frames (n, 3)."""
    direction = np.stack([np.cos(frame[:, 2]), np.sin(frame[:, 2])], axis=-1)
    return np.asarray(frame[:, None, :2] + extent[..., None] * direction[:, None, :])


@immutable
class MapCorners:
    """m corners of the map.

    identity      (m,) landmark ids
    position      (m, 2) in the map, metres
    covariance    (m, 2, 2); NaN if it was not requested
    walls         (m, 2) landmark ids of the two walls, -1 if unknown
    observations  (m,) number of keyframes
    """

    identity: Integers
    position: Floats
    covariance: Floats
    walls: Integers
    observations: Integers

    def __len__(self) -> int:
        return len(self.position)

    def __repr__(self) -> str:
        return f"<MapCorners: {counted(len(self), 'corner')}>"


@immutable
class Keyframes:
    """Poses of k keyframes.

    stamps      (k,) seconds
    poses       (k, 3) in the map
    covariance  (k, 3, 3) of each pose in the keyframe's own frame; NaN if unknown
    """

    stamps: Floats
    poses: Floats
    covariance: Floats

    @classmethod
    def without_covariance(cls, stamps: Floats, poses: Floats) -> Keyframes:
        """Return keyframes whose covariance is unknown."""
        return cls(stamps, poses, np.full((len(poses), 3, 3), np.nan))

    def __len__(self) -> int:
        return len(self.stamps)

    def __repr__(self) -> str:
        return f"<Keyframes: {counted(len(self), 'keyframe')}>"

    def position_sigma(self) -> Floats:
        """Return (k,) the standard deviation of each position in its most uncertain direction, metres."""
        result = np.full(len(self), np.nan)
        known = np.isfinite(self.covariance).all(axis=(1, 2))
        result[known] = np.sqrt(np.linalg.eigvalsh(self.covariance[known, :2, :2])[:, -1].clip(min=0.0))
        return result
