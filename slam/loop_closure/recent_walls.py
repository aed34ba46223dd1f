"""Selection of the walls that a loop search compares: the recent walls, as one rigid body, and the reference map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats, Integers
from ..mapping.landmarks import Landmarks

# Travelled metres within which a wall seen is recent; also the radius around the robot, in metres, to which recent
# walls are clipped. Origin: chosen, shortened from 8 m during development on recordings; not measured.
RECENT_DISTANCE = 6.0
# Travelled metres after which a wall belongs to the reference map.
# Origin: chosen, longer than RECENT_DISTANCE; not measured.
REFERENCE_DISTANCE = 15.0
# Metres of drift expected per metre travelled. Origin: chosen, three times that of good wheels; not measured.
TRANSLATION_DRIFT_RATE = 0.05
# Radians of drift expected per metre travelled. Origin: chosen; not measured.
ROTATION_DRIFT_RATE = np.radians(0.2)
# Metres, least expected drift. Origin: chosen; not measured.
MIN_TRANSLATION_DRIFT = 0.6
# Metres, largest expected drift. Origin: chosen, bounds the search; not measured.
MAX_TRANSLATION_DRIFT = 10.0
# Radians, least expected drift. Origin: chosen; not measured.
MIN_ROTATION_DRIFT = np.radians(6.0)
# Radians, largest expected drift. Origin: chosen, bounds the search; not measured.
MAX_ROTATION_DRIFT = np.radians(40.0)
# Factor on the expected drift within which alternatives are searched: one just beyond the drift makes a place as
# ambiguous as one within it. Origin: tuned on simulated drives; wrong closures occurred if the true place was just out
# of reach.
ALTERNATIVE_REACH = 2.0
# Metres of a wall that must be left of it after clipping. Origin: chosen, two cells of a wall; not measured.
MIN_CLIPPED_LENGTH = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class WallSet:
    """n walls as finite segments in the map.

    walls        (n,) landmark ids
    frame        (n, 3) frames at the walls' middles
    half_length  (n,) metres
    """

    walls: Integers
    frame: Floats
    half_length: Floats

    def __len__(self) -> int:
        return len(self.walls)

    def length(self) -> float:
        """Return the total length of the walls in metres."""
        return float(2 * self.half_length.sum())

    def end_points(self) -> Floats:
        """Return both ends (n, 2, 2) of each wall in the map, metres."""
        along = np.stack([np.cos(self.frame[:, 2]), np.sin(self.frame[:, 2])], axis=-1) * self.half_length[:, None]
        return np.stack([self.frame[:, :2] - along, self.frame[:, :2] + along], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceMap:
    """Older walls near enough to be observed again, and the drift expected since each was seen last.

    wall_set     n walls
    not_recent   (n,) true if the wall was not seen within RECENT_DISTANCE
    translation  (n,) expected drift, metres
    rotation     (n,) expected drift, radians
    """

    wall_set: WallSet
    not_recent: NDArray[np.bool_]
    translation: Floats
    rotation: Floats


def select_recent_and_reference(
    landmarks: Landmarks, pose: se2.Pose, travelled: Floats
) -> tuple[WallSet, ReferenceMap]:
    """Select the recent walls around the robot's pose, and the reference map.

    A wall can be in both: an old wall that was seen again supports the null hypothesis, as others may contradict it.
    `travelled` (k,) is the travelled distance at each keyframe, metres.
    """
    walls = landmarks.walls.rows
    active = walls["in_graph"] & landmarks.active()
    since_seen = travelled[-1] - travelled[walls["last_seen"]]
    rows = np.flatnonzero(active & (since_seen < RECENT_DISTANCE) & (walls["observations"] >= 2))
    low, high = _clip_extent(walls["frame"][rows], walls["low"][rows], walls["high"][rows], pose)
    visible = high - low > MIN_CLIPPED_LENGTH
    recent = _wall_set(rows[visible], walls["frame"][rows[visible]], low[visible], high[visible])

    old = active & (travelled[-1] - travelled[walls["first_seen"]] > REFERENCE_DISTANCE)
    since = np.where(since_seen > RECENT_DISTANCE, since_seen, np.max(since_seen[old], initial=0.0))
    translation = np.clip(TRANSLATION_DRIFT_RATE * since, MIN_TRANSLATION_DRIFT, MAX_TRANSLATION_DRIFT)
    rotation = np.clip(ROTATION_DRIFT_RATE * since, MIN_ROTATION_DRIFT, MAX_ROTATION_DRIFT)
    viewpoint = se2.transform(se2.inverse(walls["frame"]), pose[:2])
    beyond = np.maximum(0.0, np.maximum(walls["low"] - viewpoint[:, 0], viewpoint[:, 0] - walls["high"]))
    reach = RECENT_DISTANCE + ALTERNATIVE_REACH * translation
    near = np.flatnonzero(old & (np.hypot(beyond, viewpoint[:, 1]) < reach))
    reference = _wall_set(near, walls["frame"][near], walls["low"][near], walls["high"][near])
    return recent, ReferenceMap(reference, since_seen[near] > RECENT_DISTANCE, translation[near], rotation[near])


def _clip_extent(frame: Floats, low: Floats, high: Floats, pose: se2.Pose) -> tuple[Floats, Floats]:
    """Clip the extents of walls to RECENT_DISTANCE around the robot; high < low if nothing is left."""
    viewpoint = se2.transform(se2.inverse(frame), pose[:2]).reshape(-1, 2)
    half_chord = np.sqrt(np.maximum(0.0, RECENT_DISTANCE**2 - viewpoint[:, 1] ** 2))
    return np.maximum(low, viewpoint[:, 0] - half_chord), np.minimum(high, viewpoint[:, 0] + half_chord)


def _wall_set(walls: Integers, frame: Floats, low: Floats, high: Floats) -> WallSet:
    """Build a wall set with frames moved to the middles of the extents."""
    middle = np.column_stack([0.5 * (low + high), np.zeros((len(low), 2))])
    return WallSet(walls, se2.compose(frame, middle).reshape(-1, 3), 0.5 * (high - low))
