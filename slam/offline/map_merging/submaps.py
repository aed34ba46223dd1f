"""Split a session into submaps of some metres of driving, each of which can be relocalised in another map."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ...estimation.refinement.landmark_recount import recompute_covariances, recount_observations
from ...estimation.refinement.scan_history import ScanHistory
from ...loop_closure.submap_search import SUBMAP_LENGTH
from ...mapping.keyframes import LandmarkIds
from ...mapping.mapper import Mapper
from ...mapping.unconfirmed_observations import CONFIRMING_KEYFRAMES
from ...recognition.map_descriptor import MapDescriptor, describe_map


def split_into_submaps(mapper: Mapper, history: ScanHistory) -> Iterator[tuple[range, MapDescriptor]]:
    """Yield the keyframes of consecutive submaps of SUBMAP_LENGTH metres each, without overlap, and their landmarks.

    The landmarks are in the frame of the session's map.
    """
    index = np.floor(np.array(mapper.travelled) / SUBMAP_LENGTH).astype(int)
    starts = np.flatnonzero(np.diff(index, prepend=-1))
    for first, end in zip(starts, [*starts[1:], len(index)], strict=True):
        keyframes = range(int(first), int(end))
        yield keyframes, _describe_submap(mapper, history, keyframes)


def _describe_submap(mapper: Mapper, history: ScanHistory, keyframes: range) -> MapDescriptor:
    """Describe a submap by the observations of consecutive keyframes only."""
    rows, poses = (
        history.keyframes[keyframes.start : keyframes.stop],
        mapper.keyframe_poses[keyframes.start : keyframes.stop],
    )
    landmarks = copy.deepcopy(mapper.landmarks)
    landmarks.forget_openings()  # what these keyframes observed existed then
    merged_into = landmarks.walls.rows["merged_into"]
    landmark_ids = [
        LandmarkIds(np.where(ids.walls >= 0, merged_into[ids.walls], -1), ids.corners)
        for ids in mapper.landmark_ids[keyframes.start : keyframes.stop]
    ]
    part = replace(history, keyframes=rows)
    recount_observations(landmarks, part, landmark_ids, poses)
    recompute_covariances(landmarks, part, landmark_ids, poses, mapper.roughness.variances)
    landmarks.confirm_observed(CONFIRMING_KEYFRAMES)
    return describe_map(landmarks, mapper.roughness.variances)
