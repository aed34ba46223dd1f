"""What a round of refinement makes of the landmarks: each is what keyframes see of it now, and no more."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers import se2

from ...geometry.segments import Floats
from ...mapping.keyframes import LandmarkIds
from ...mapping.landmarks import Landmarks
from ...mapping.wall_roughness import uneven
from .scan_history import ScanHistory

GONE = -1  # stands for the wall that speaks for one which nobody sees any more


def recount(landmarks: Landmarks, history: ScanHistory, landmark_ids: Sequence[LandmarkIds], poses: Floats) -> None:
    """Take the extents and counts of all landmarks from what keyframes at `poses` (k, 3) see of them by `names`.

    What no keyframe sees is no landmark any more. Identities stay.
    """
    walls, corners = landmarks.walls.rows, landmarks.corners.rows
    walls["observations"], walls["last_seen"], walls["first_seen"] = 0, GONE, len(poses)
    walls["low"], walls["high"], walls["in_graph"] = np.inf, -np.inf, False
    landmarks.covered = [frozenset()] * len(walls)
    corners["observations"], corners["last_seen"], corners["in_graph"] = 0, GONE, False
    for k, (row, seen_as) in enumerate(zip(history.keyframes, landmark_ids, strict=True)):
        seen = history.scans[row].features
        frames = se2.compose(poses[k], seen.segments.frame).reshape(-1, 3)
        for i in np.flatnonzero(seen_as.walls >= 0):
            wall = int(seen_as.walls[i])
            landmarks.see_wall(wall, frames[i], seen.segments.half_length[i], k)
            walls["first_seen"][wall] = min(walls["first_seen"][wall], k)
        for i in np.flatnonzero(seen_as.corners >= 0):
            landmarks.see_corner(int(seen_as.corners[i]), se2.wrap(seen.corners.headings[i] + poses[k, 2]), k)
    for wall in landmarks.opened:
        landmarks.shorten(wall)
    unseen = (walls["observations"] == 0) & (walls["merged_into"] == np.arange(len(walls)))
    walls["merged_into"][unseen] = GONE
    walls["merged_into"][(walls["merged_into"] >= 0) & np.isin(walls["merged_into"], np.flatnonzero(unseen))] = GONE
    walls["first_seen"][walls["observations"] == 0] = walls["last_seen"][walls["observations"] == 0] = 0
    corners["position"][corners["observations"] == 0] = np.nan  # is near nothing


def measure(
    landmarks: Landmarks, history: ScanHistory, landmark_ids: Sequence[LandmarkIds], poses: Floats, roughness: float
) -> None:
    """Set the covariances of all landmarks to what the keyframes that see them leave uncertain, at their `poses`.

    As seen from around there, that is; what all of them have in common is left out. A wall's unevenness does not
    average out: every look at one place of it meets the same.
    """
    walls, corners = landmarks.walls.rows, landmarks.corners.rows
    of_walls, of_corners = np.zeros((len(walls), 2, 2)), np.zeros((len(corners), 2, 2))
    for k, (row, seen_as) in enumerate(zip(history.keyframes, landmark_ids, strict=True)):
        seen = history.scans[row].features
        known = np.flatnonzero(seen_as.walls >= 0)
        named, segments = seen_as.walls[known], seen.segments
        frames = se2.compose(poses[k], segments.frame[known]).reshape(-1, 3)
        carry = np.tile(np.eye(2), (len(known), 1, 1))
        carry[:, 0, 1] = se2.between(frames, walls["frame"][named]).reshape(-1, 3)[:, 0]
        covariance = uneven(segments.covariance[known], segments.half_length[known], roughness)
        np.add.at(of_walls, named, np.linalg.inv(carry @ covariance @ carry.transpose(0, 2, 1)))
        known = np.flatnonzero(seen_as.corners >= 0)
        c, s = np.cos(poses[k, 2]), np.sin(poses[k, 2])
        rotation = np.array([[c, -s], [s, c]])
        spread = seen.corners.covariance[known] + roughness * np.eye(2)
        np.add.at(of_corners, seen_as.corners[known], np.linalg.inv(rotation @ spread @ rotation.T))
    seen_walls, seen_corners = walls["observations"] > 0, corners["observations"] > 0
    half_length = 0.5 * (walls["high"] - walls["low"])[seen_walls]
    walls["covariance"][seen_walls] = uneven(np.asarray(np.linalg.inv(of_walls[seen_walls])), half_length, roughness)
    corners["covariance"][seen_corners] = np.linalg.inv(of_corners[seen_corners]) + roughness * np.eye(2)
