"""Replay of a finished drive: the map as it was after each keyframe, with the present estimate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from ..geometry.segments import Segments
from .mapper import Mapper
from .unconfirmed_observations import CONFIRMING_KEYFRAMES


def replay(mapper: Mapper, segments: Iterable[Segments]) -> Iterator[Mapper]:
    """Yield the map after each keyframe: the keyframes so far, and the walls with their observations so far.

    Poses, frames, extents and the graph are those of the present estimate, and `pose_covariances` stays empty.
    `segments` are those of each keyframe. The yielded mapper is the same object each time; it must not be changed.
    """
    past = Mapper.with_landmarks_of(mapper)
    past.graph, past.correlated_drift = mapper.graph, mapper.correlated_drift
    walls = past.landmarks.walls.rows
    confirmed = walls["in_graph"].copy()
    walls["in_graph"], walls["observations"], walls["first_seen"], walls["last_seen"] = False, 0, 0, 0
    for k, (observed_segments, landmark_ids) in enumerate(zip(segments, mapper.landmark_ids, strict=True)):
        observed = np.unique(landmark_ids.walls[landmark_ids.walls >= 0])
        walls["first_seen"][observed] = np.where(walls["observations"][observed] == 0, k, walls["first_seen"][observed])
        walls["observations"][observed] += 1
        walls["last_seen"][observed] = k
        walls["in_graph"][observed] = confirmed[observed] & (walls["observations"][observed] >= CONFIRMING_KEYFRAMES)
        past.keyframe_count = k + 1
        past.keyframe_poses, past.travelled = mapper.keyframe_poses[: k + 1], mapper.travelled[: k + 1]
        past.recent_segments.append((k, observed_segments))
        yield past
