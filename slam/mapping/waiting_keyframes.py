"""Keyframes that wait for the next solution of the graph, and reading them back after it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ..geometry.segments import Floats, Segments
from ..odometry.correlated_drift import embed_position_covariance
from .keyframes import LandmarkIds
from .local_map import LOCAL_MAP_MARGIN
from .read_back import read_back_covariances

if TYPE_CHECKING:
    from .mapper import Mapper

# Metres of driving from one solution of the graph to the next; tracking supplies the poses in between.
# Origin: definition, half of LOCAL_MAP_MARGIN: so the scans are still matched to walls that were read back.
SOLVE_DISTANCE = 0.5 * LOCAL_MAP_MARGIN
# Radians of turning likewise, the sum of those between keyframes. Origin: chosen, a quarter of the field of view of a
# half-circle lidar: most of a scan still shows walls that were read back.
SOLVE_TURN = math.radians(45.0)
# Keyframes after which the estimate of all landmarks is read back, not only of those nearby.
# Origin: chosen, the cost of reading all back becomes negligible; not measured.
FULL_READ_BACK_INTERVAL = 20


@immutable
class WaitingKeyframe:
    """Keyframe that has not been read back from the graph yet.

    segments      in the base's frame
    landmark_ids  of its segments and corners
    points        (p, 2) of its scan, in the base's frame
    """

    segments: Segments
    landmark_ids: LandmarkIds
    points: Floats


class WaitingKeyframes:
    """The last keyframes of a mapper, from the first one on that has not been read back from the graph."""

    def __init__(self, keyframes: Iterable[WaitingKeyframe] = ()) -> None:
        self._keyframes = list(keyframes)

    def __len__(self) -> int:
        return len(self._keyframes)

    @property
    def landmark_ids(self) -> list[LandmarkIds]:
        """Landmark ids of each keyframe."""
        return [keyframe.landmark_ids for keyframe in self._keyframes]

    def append(self, keyframe: WaitingKeyframe) -> None:
        """Append a keyframe that was added to the graph."""
        self._keyframes.append(keyframe)

    def has_moved_on(self, poses: Floats, travelled: Sequence[float]) -> bool:
        """Return True if the robot has driven SOLVE_DISTANCE or turned SOLVE_TURN since the graph was solved.

        `poses` (k, 3) and metres driven, `travelled`, are those of all keyframes.
        """
        solved = max(0, len(poses) - 1 - len(self))
        turned = np.abs(se2.wrap(np.diff(poses[solved:, 2]))).sum()
        return bool(travelled[-1] - travelled[solved] >= SOLVE_DISTANCE or turned >= SOLVE_TURN)

    def read_back(self, mapper: Mapper) -> list[Floats]:
        """Read back the keyframes, after the graph was solved with them, and the landmarks around; none wait then.

        Returns the points of each of these keyframes.
        """
        waiting, self._keyframes = self._keyframes, []
        last, first = mapper.keyframe_count - 1, mapper.keyframe_count - len(waiting)
        mapper.replace_last_poses(mapper.graph.keyframe_poses_of(range(first, last + 1)))
        reach = LOCAL_MAP_MARGIN + max(keyframe.segments.reach() for keyframe in waiting)
        reads_all = any(k % FULL_READ_BACK_INTERVAL == 0 for k in range(first, last + 1))
        mapper.read_back(None if reads_all else reach)
        independent = read_back_covariances(
            mapper.landmarks, mapper.graph, last, [keyframe.landmark_ids for keyframe in waiting]
        )
        correlated = [embed_position_covariance(drift) for drift in mapper.correlated_drift[first:]]
        mapper.replace_last_covariances(independent + correlated)
        return [keyframe.points for keyframe in waiting]
