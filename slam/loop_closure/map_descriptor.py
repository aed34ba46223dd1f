"""What of a map a place is recognised by: its confirmed walls, where along them they were seen, and its corners."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drivers import se2

from ..geometry.segments import Floats, Integers
from ..mapping.landmarks import CELL, Landmarks

BRIDGED = 2  # cells of a wall not seen between two that were: the ends of two segments, no door


@dataclass(frozen=True, slots=True, eq=False)
class MapDescriptor:
    """n walls and m corners in one frame.

    walls        (n,) identities
    frame        (n, 3) at the walls' middles: x along the wall, which is seen from y > 0
    half_length  (n,) metres
    covariance   (n, 2, 2) of offset and heading at the frame, as seen from where the wall was seen last, with the
                 unevenness of walls
    stretches    (s, 2) metres along the walls from their frames where they were seen: between them may be doors
    stretch_wall (s,) row of the wall that a stretch is of, ascending
    corners      (m, 2) positions
    headings     (m, 2) of the walls before and after a corner
    """

    walls: Integers
    frame: Floats
    half_length: Floats
    covariance: Floats
    stretches: Floats
    stretch_wall: Integers
    corners: Floats
    headings: Floats

    def __len__(self) -> int:
        return len(self.walls)


def describe_map(landmarks: Landmarks, roughness: float) -> MapDescriptor:
    """All that is confirmed of some landmarks; `flatness` is the variance of the walls' unevenness, metres squared."""
    rows = landmarks.walls.rows
    walls = np.flatnonzero(rows["in_graph"] & landmarks.active())
    rows = rows[walls]
    middle, half = 0.5 * (rows["low"] + rows["high"]), 0.5 * (rows["high"] - rows["low"])
    along = np.column_stack([middle, np.zeros((len(walls), 2))])
    carry = np.tile(np.eye(2), (len(walls), 1, 1))
    carry[:, 0, 1] = middle
    covariance = carry @ rows["covariance"] @ carry.transpose(0, 2, 1)
    covariance[:, 0, 0] += roughness
    covariance[:, 1, 1] += 3 * roughness / np.maximum(half, CELL) ** 2
    found = [_stretches(landmarks, int(wall)) - by for wall, by in zip(walls, middle, strict=True)]
    confirmed = np.flatnonzero(landmarks.corners.rows["in_graph"])
    corners = landmarks.corners.rows[confirmed[landmarks.active_corners(confirmed)]]
    return MapDescriptor(
        walls=walls,
        frame=se2.compose(rows["frame"], along).reshape(-1, 3),
        half_length=half,
        covariance=covariance,
        stretches=np.concatenate([np.zeros((0, 2)), *found]),
        stretch_wall=np.repeat(np.arange(len(walls)), [len(some) for some in found]),
        corners=corners["position"].copy(),
        headings=corners["headings"].copy(),
    )


def seen_from(pose: se2.Pose, scene: MapDescriptor) -> MapDescriptor:
    """The same walls and corners in the frame of a pose."""
    return replace(
        scene,
        frame=se2.between(pose, scene.frame).reshape(-1, 3),
        corners=se2.transform(se2.inverse(pose), scene.corners).reshape(-1, 2),
        headings=se2.wrap(scene.headings - pose[2]),
    )


def _stretches(landmarks: Landmarks, wall: int) -> Floats:
    """(s, 2): from where to where along a wall it was seen, metres from its frame."""
    cells = np.array(sorted(landmarks.covered[wall]), dtype=np.int64)
    if not len(cells):
        return np.zeros((0, 2))
    breaks = np.flatnonzero(np.diff(cells) > BRIDGED + 1)
    first, last = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [len(cells) - 1]])
    return CELL * np.column_stack([cells[first], cells[last] + 1.0])
