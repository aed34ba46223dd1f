"""What is compared when a place may have been seen before: the walls of the last metres, rigid, and the old map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats, Integers
from ..mapping.landmarks import Landmarks

RECENT_WAY = 6.0  # metres of driving whose walls make the constellation, and its radius around the robot
OLD_WAY = 15.0  # metres of driving after which a wall belongs to the old map
TRANSLATION_DRIFT = 0.05  # metres of drift to be expected a metre driven: three times what good wheels do
ROTATION_DRIFT = np.radians(0.2)  # radians a metre
LEAST_TRANSLATION, MOST_TRANSLATION = 0.6, 10.0  # metres
# Times as far as drift is expected to have led, other places are looked for that would explain as much: what lies just
# out of reach makes a place as ambiguous as what lies within.
RIVALS = 2.0
LEAST_ROTATION, MOST_ROTATION = np.radians(6.0), np.radians(40.0)


@dataclass(frozen=True, slots=True, eq=False)
class WallSet:
    """n walls as finite segments in the map: identities, frames (n, 3) at their middle, half lengths (n,) metres."""

    walls: Integers
    frame: Floats
    half_length: Floats

    def __len__(self) -> int:
        return len(self.walls)

    def length(self) -> float:
        """Metres of wall."""
        return float(2 * self.half_length.sum())

    def end_points(self) -> Floats:
        """(n, 2, 2): both ends of each wall in the map, metres."""
        along = np.stack([np.cos(self.frame[:, 2]), np.sin(self.frame[:, 2])], axis=-1) * self.half_length[:, None]
        return np.stack([self.frame[:, :2] - along, self.frame[:, :2] + along], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceMap:
    """Old walls near enough to be met again, and for each how far drift may have carried the robot from it.

    left (n,) whether a wall has not been seen lately; translation (n,) metres, rotation (n,) radians.
    """

    wall_set: WallSet
    left: NDArray[np.bool_]
    translation: Floats
    rotation: Floats


def recent_and_reference(landmarks: Landmarks, pose: se2.Pose, travelled: Floats) -> tuple[WallSet, ReferenceMap]:
    """The walls around the robot's pose seen lately, and those that have long been known.

    A wall can be both: seen again, it speaks for where the robot is believed to be, as others may speak against it.
    `ways` (k,) are the metres driven up to each keyframe.
    """
    walls = landmarks.walls.rows
    active = walls["in_graph"] & landmarks.active()
    since_seen = travelled[-1] - travelled[walls["last_seen"]]
    recent = np.flatnonzero(active & (since_seen < RECENT_WAY) & (walls["observations"] >= 2))
    low, high = _clipped(walls["frame"][recent], walls["low"][recent], walls["high"][recent], pose)
    visible = high - low > 0.2
    recents = _constellation(recent[visible], walls["frame"][recent[visible]], low[visible], high[visible])

    old = active & (travelled[-1] - travelled[walls["first_seen"]] > OLD_WAY)
    gone = np.where(since_seen > RECENT_WAY, since_seen, np.max(since_seen[old], initial=0.0))
    translation = np.clip(TRANSLATION_DRIFT * gone, LEAST_TRANSLATION, MOST_TRANSLATION)
    rotation = np.clip(ROTATION_DRIFT * gone, LEAST_ROTATION, MOST_ROTATION)
    seen_from = se2.transform(se2.inverse(walls["frame"]), pose[:2])
    beyond = np.maximum(0.0, np.maximum(walls["low"] - seen_from[:, 0], seen_from[:, 0] - walls["high"]))
    near = np.flatnonzero(old & (np.hypot(beyond, seen_from[:, 1]) < RECENT_WAY + RIVALS * translation))
    olds = _constellation(near, walls["frame"][near], walls["low"][near], walls["high"][near])
    return recents, ReferenceMap(olds, since_seen[near] > RECENT_WAY, translation[near], rotation[near])


def _clipped(frame: Floats, low: Floats, high: Floats, pose: se2.Pose) -> tuple[Floats, Floats]:
    """The extent of walls within RECENT_WAY of the robot (empty where high < low)."""
    seen_from = se2.transform(se2.inverse(frame), pose[:2]).reshape(-1, 2)
    half_chord = np.sqrt(np.maximum(0.0, RECENT_WAY**2 - seen_from[:, 1] ** 2))
    return np.maximum(low, seen_from[:, 0] - half_chord), np.minimum(high, seen_from[:, 0] + half_chord)


def _constellation(walls: Integers, frame: Floats, low: Floats, high: Floats) -> WallSet:
    middle = np.column_stack([0.5 * (low + high), np.zeros((len(low), 2))])
    return WallSet(walls, se2.compose(frame, middle).reshape(-1, 3), 0.5 * (high - low))
