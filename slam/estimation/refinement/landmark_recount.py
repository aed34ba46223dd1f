"""Recompute extents, counts and covariances of landmarks from the present observations of the keyframes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers import se2

from ...geometry.roughness import Roughness, add_roughness
from ...geometry.segments import Floats
from ...mapping.keyframes import LandmarkIds
from ...mapping.landmarks import Landmarks
from ...mapping.repeated_observation import drop_unobserved, reset_observations
from .scan_history import ScanHistory


def recount_observations(
    landmarks: Landmarks, history: ScanHistory, landmark_ids: Sequence[LandmarkIds], poses: Floats
) -> None:
    """Recompute the extents and counts of all landmarks from the observations of keyframes at `poses` (k, 3).

    `landmark_ids` (k) associate their features. Unobserved landmarks are removed; ids do not change.
    """
    reset_observations(landmarks)
    for k, (row, ids) in enumerate(zip(history.keyframes, landmark_ids, strict=True)):
        features = history.scans[row].features
        frames = se2.compose(poses[k], features.segments.frame).reshape(-1, 3)
        points = se2.transform(poses[k], features.points.xy).reshape(-1, 2)
        for i in np.flatnonzero(ids.walls >= 0):
            landmarks.observe_wall(int(ids.walls[i]), frames[i], features.segments.half_length[i], k, points)
        for i in np.flatnonzero(ids.corners >= 0):
            landmarks.observe_corner(int(ids.corners[i]), se2.wrap(features.corners.headings[i] + poses[k, 2]), k)
    drop_unobserved(landmarks)


def recompute_covariances(
    landmarks: Landmarks, history: ScanHistory, landmark_ids: Sequence[LandmarkIds], poses: Floats, roughness: Roughness
) -> None:
    """Recompute the covariances of all landmarks from the observations of keyframes at `poses` (k, 3).

    They are relative to the keyframes nearby; errors of the poses are not included. `roughness` is added again at the
    end: it does not average out, since all observations of a piece of wall share it.
    """
    walls, corners = landmarks.walls.rows, landmarks.corners.rows
    wall_information, corner_information = np.zeros((len(walls), 2, 2)), np.zeros((len(corners), 2, 2))
    for k, (row, ids) in enumerate(zip(history.keyframes, landmark_ids, strict=True)):
        features = history.scans[row].features
        associated = np.flatnonzero(ids.walls >= 0)
        observed, segments = ids.walls[associated], features.segments
        frames = se2.compose(poses[k], segments.frame[associated]).reshape(-1, 3)
        to_wall = np.tile(np.eye(2), (len(associated), 1, 1))
        to_wall[:, 0, 1] = se2.between(frames, walls["frame"][observed]).reshape(-1, 3)[:, 0]
        covariance = add_roughness(segments.covariance[associated], segments.half_length[associated], roughness)
        np.add.at(wall_information, observed, np.linalg.inv(to_wall @ covariance @ to_wall.transpose(0, 2, 1)))
        associated = np.flatnonzero(ids.corners >= 0)
        c, s = np.cos(poses[k, 2]), np.sin(poses[k, 2])
        rotation = np.array([[c, -s], [s, c]])
        covariance = features.corners.covariance[associated] + roughness.offset * np.eye(2)
        np.add.at(corner_information, ids.corners[associated], np.linalg.inv(rotation @ covariance @ rotation.T))
    observed_walls, observed_corners = np.flatnonzero(walls["observations"]), np.flatnonzero(corners["observations"])
    half_length = 0.5 * (walls["high"] - walls["low"])[observed_walls]
    wall_covariance = np.asarray(np.linalg.inv(wall_information[observed_walls]))
    landmarks.set_wall_covariances(observed_walls, add_roughness(wall_covariance, half_length, roughness))
    corner_covariance = np.asarray(np.linalg.inv(corner_information[observed_corners])) + roughness.offset * np.eye(2)
    landmarks.set_corner_covariances(observed_corners, corner_covariance)
