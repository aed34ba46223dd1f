"""Copy of a run as it is at one moment, to be saved while the run goes on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import MapError
from .estimation.map_view import covariances_when_last_seen, map_features
from .events import Finished

if TYPE_CHECKING:
    from .io.sessions import StoredSession


@dataclass(frozen=True, slots=True, eq=False)
class RunSnapshot:
    """Copy of a run that shares nothing with it that changes; may be used in another thread.

    session  estimate, to be stored and continued after `finished`, which connects its parts
    summary  of the run so far, for `Finished.summary`
    after    stamp (seconds) after which poses belong to this run
    """

    session: StoredSession
    summary: dict[str, Any]
    after: float

    def finished(self) -> Finished:
        """Return map and trajectory so far. The trajectory has the poses of the scans, but none in between.

        Covariances of walls and corners are those from when each was last seen; those of keyframes are not computed,
        which would take seconds in a large map. Raises MapError if the trajectory has no pose yet.
        """
        state = self.session.slam_state
        mapper = state.mapper
        mapper.gauge.release(mapper)
        walls, corners = map_features(mapper)
        of_walls, of_corners = covariances_when_last_seen(mapper, walls, corners)
        stamps, poses = state.trajectory.at_scans(mapper.keyframe_poses)
        later = stamps > self.after
        if not later.any():
            raise MapError("the robot was not relocalised in the map yet")
        return Finished(
            walls=replace(walls, covariance=of_walls),
            corners=replace(corners, covariance=of_corners),
            keyframe_stamps=np.array(state.keyframe_stamps),
            keyframes=mapper.keyframe_poses,
            stamps=stamps[later],
            poses=poses[later],
            summary=self.summary,
        )
