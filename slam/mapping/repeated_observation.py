"""Observe landmarks again: clear what was observed of them, and deactivate those that no keyframe observes again.

Between `reset_observations`, or `forget_observations` for some walls, and `drop_unobserved` the caller observes the
landmarks from every keyframe. Landmark ids and the openings of walls stay.
"""

from __future__ import annotations

import numpy as np

from ..geometry.segments import Integers
from .landmark_table import UNOBSERVED
from .landmarks import Landmarks


def reset_observations(landmarks: Landmarks) -> None:
    """Clear the extents, observations and confirmation of all landmarks."""
    walls, corners = landmarks.walls.rows, landmarks.corners.rows
    walls["observations"], walls["last_seen"], walls["first_seen"] = 0, UNOBSERVED, np.iinfo(np.int64).max
    walls["low"], walls["high"], walls["in_graph"] = np.inf, -np.inf, False
    landmarks.covered = [frozenset()] * len(walls)
    corners["observations"], corners["last_seen"], corners["in_graph"] = 0, UNOBSERVED, False


def forget_observations(landmarks: Landmarks, walls: Integers) -> None:
    """Clear the extents and observations of some walls (n,), and unmerge them; the caller merges them again."""
    rows = landmarks.walls.rows
    rows["observations"][walls], rows["last_seen"][walls] = 0, UNOBSERVED
    rows["first_seen"][walls] = np.iinfo(np.int64).max
    rows["low"][walls], rows["high"][walls], rows["merged_into"][walls] = np.inf, -np.inf, walls
    for wall in walls.tolist():
        landmarks.covered[wall] = frozenset()


def drop_unobserved(landmarks: Landmarks) -> None:
    """Deactivate the landmarks that no keyframe has observed again; corners get the position NaN."""
    walls, corners = landmarks.walls.rows, landmarks.corners.rows
    for wall in landmarks.opened:
        landmarks.trim_extent(wall)
    unobserved = walls["observations"] == 0
    dropped = unobserved & (walls["merged_into"] == np.arange(len(walls)))
    walls["merged_into"][dropped] = UNOBSERVED
    merged = walls["merged_into"] >= 0
    walls["merged_into"][merged & np.isin(walls["merged_into"], np.flatnonzero(dropped))] = UNOBSERVED
    walls["first_seen"][unobserved] = walls["last_seen"][unobserved] = 0
    corners["position"][corners["observations"] == 0] = np.nan  # no distance to it is small
