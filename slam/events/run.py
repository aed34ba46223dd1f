"""Events of a run as a whole: messages, doubts, and its end."""

from __future__ import annotations

from dataclasses import field

from drivers.immutable import immutable

from ..formatting import counted
from ..geometry.segments import Floats
from ..mapping.map_features import Keyframes, MapCorners, MapWalls


@immutable
class Notice:
    """A message for the user, for example about a gap in the data, a jump of the odometry, or a lost pose."""

    stamp: float
    text: str
    level: str = "WARN"


@immutable
class SuspectFound:
    """A check of the finished run found a contradiction at `stamp`; published at the end of the run, worst first.

    index     last keyframe at that time
    text      sentence with the time since the start of the run and the figures
    position  (2,) in the final map, metres
    """

    index: int
    stamp: float
    text: str
    position: Floats


@immutable
class Finished:
    """The run is over: final map and trajectory.

    walls, corners  walls and corners with marginal covariances
    keyframes       keyframes with marginal covariances
    stamps          (m,) seconds of all odometry readings and scans
    poses           (m, 3) of the base in the map at these stamps
    summary         counts, timings and learned values, as plain data
    """

    walls: MapWalls
    corners: MapCorners
    keyframes: Keyframes
    stamps: Floats
    poses: Floats
    summary: dict[str, object] = field(default_factory=dict)

    def __repr__(self) -> str:
        found = (len(self.walls), "wall"), (len(self.corners), "corner"), (len(self.keyframes), "keyframe")
        return f"<Finished: {', '.join(counted(*one) for one in found)}, {counted(len(self.poses), 'pose')}>"
