"""A session in pieces: what was seen on some metres of its way, as small maps that can be looked for in another."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ...estimation.refinement.landmark_recount import measure, recount
from ...estimation.refinement.scan_history import ScanHistory
from ...loop_closure.map_descriptor import describe_map
from ...loop_closure.relocalisation import Submap
from ...mapping.keyframes import LandmarkIds
from ...mapping.mapper import CONFIRMING_KEYFRAMES, KEPT_VIEWS, Mapper

WAY = 6.0  # metres of driving that a fragment is made of


def fragments(mapper: Mapper, drive: ScanHistory) -> Iterator[tuple[range, Submap]]:
    """The keyframes of each stretch of WAY metres, one after the other without overlap, and what was seen from them.

    A fragment's frame is the session's map.
    """
    piece = np.floor(np.array(mapper.travelled) / WAY).astype(int)
    starts = np.flatnonzero(np.diff(piece, prepend=-1))
    for first, end in zip(starts, [*starts[1:], len(piece)], strict=True):
        keyframes = range(int(first), int(end))
        yield keyframes, _fragment(mapper, drive, keyframes)


def _fragment(mapper: Mapper, drive: ScanHistory, keyframes: range) -> Submap:
    """What some keyframes in a row saw, and nothing that others did."""
    rows, poses = (
        drive.keyframes[keyframes.start : keyframes.stop],
        mapper.keyframe_poses[keyframes.start : keyframes.stop],
    )
    landmarks = copy.deepcopy(mapper.landmarks)
    landmarks.opened = {}  # what these keyframes saw was there
    kept = landmarks.walls.rows["merged_into"]
    landmark_ids = [
        LandmarkIds(np.where(seen_as.walls >= 0, kept[seen_as.walls], -1), seen_as.corners)
        for seen_as in mapper.landmark_ids[keyframes.start : keyframes.stop]
    ]
    stretch = replace(drive, keyframes=rows)
    recount(landmarks, stretch, landmark_ids, poses)
    measure(landmarks, stretch, landmark_ids, poses, mapper.roughness.variance)
    for table in (landmarks.walls.rows, landmarks.corners.rows):
        table["in_graph"] = table["observations"] >= CONFIRMING_KEYFRAMES
    views = [(pose, drive.scans[row].features.segments) for pose, row in zip(poses, rows, strict=True)]
    return Submap(describe_map(landmarks, mapper.roughness.variance), poses[-1], views[-KEPT_VIEWS:])
