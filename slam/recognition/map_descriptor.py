"""Map descriptor: the confirmed walls of a map, and their observed stretches.

A submap is searched in a map by the descriptors of both.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.immutable import immutable

from ..geometry.roughness import Roughness, add_roughness
from ..geometry.segments import Floats, Integers
from ..mapping.landmarks import Landmarks
from ..mapping.wall_cells import END_ERROR_CELLS, WALL_CELL


@immutable
class MapDescriptor:
    """n walls in one frame.

    walls         (n,) landmark ids
    frame         (n, 3) at the walls' middles: x along the wall, which is seen from y > 0
    half_length   (n,) metres
    covariance    (n, 2, 2) of offset and heading at the frame, relative to the keyframe that saw the wall last,
                  including wall roughness
    stretches     (s, 2) observed stretches of the walls, metres along them from their frames; gaps may be doors
    stretch_wall  (s,) row of the wall of each stretch, ascending
    """

    walls: Integers
    frame: Floats
    half_length: Floats
    covariance: Floats
    stretches: Floats
    stretch_wall: Integers

    def __len__(self) -> int:
        return len(self.walls)


def describe_map(
    landmarks: Landmarks, roughness: Roughness, observers: NDArray[np.bool_] | None = None
) -> MapDescriptor:
    """Describe the confirmed walls; `roughness` is that of the walls.

    With `observers` (k,), only those that one of these keyframes saw last.
    """
    rows = landmarks.walls.rows
    chosen = rows["in_graph"] & landmarks.active()
    if observers is not None:
        chosen &= observers[rows["last_seen"]]
    walls = np.flatnonzero(chosen)
    rows = rows[walls]
    middle, half = 0.5 * (rows["low"] + rows["high"]), 0.5 * (rows["high"] - rows["low"])
    along = np.column_stack([middle, np.zeros((len(walls), 2))])
    transport = np.tile(np.eye(2), (len(walls), 1, 1))
    transport[:, 0, 1] = middle
    covariance = transport @ rows["covariance"] @ transport.transpose(0, 2, 1)
    stretches = [_observed_stretches(landmarks, int(wall)) - by for wall, by in zip(walls, middle, strict=True)]
    return MapDescriptor(
        walls=walls,
        frame=se2.compose(rows["frame"], along).reshape(-1, 3),
        half_length=half,
        covariance=add_roughness(covariance, np.maximum(half, WALL_CELL), roughness),
        stretches=np.concatenate([np.zeros((0, 2)), *stretches]),
        stretch_wall=np.repeat(np.arange(len(walls)), [len(some) for some in stretches]),
    )


def express_in_frame(pose: se2.Pose, descriptor: MapDescriptor) -> MapDescriptor:
    """Return the descriptor in the frame of a pose, which is given in the descriptor's frame."""
    return replace(descriptor, frame=se2.between(pose, descriptor.frame).reshape(-1, 3))


def _observed_stretches(landmarks: Landmarks, wall: int) -> Floats:
    """Return begin and end (s, 2) of the observed stretches of a wall, metres from its frame."""
    cells = np.array(sorted(landmarks.covered[wall]), dtype=np.int64)
    if not len(cells):
        return np.zeros((0, 2))
    breaks = np.flatnonzero(np.diff(cells) > END_ERROR_CELLS + 1)
    first, last = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [len(cells) - 1]])
    return WALL_CELL * np.column_stack([cells[first], cells[last] + 1.0])
