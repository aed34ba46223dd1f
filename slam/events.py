"""What the pipeline tells its listeners. Events are plain data, copied out of the estimate; a sink may keep them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, TypeAlias

import numpy as np

from drivers.se2 import Pose

from .geometry.segments import CornerPoints, Floats, Integers, Segments
from .graph.factor_residuals import Residuals


@dataclass(frozen=True, slots=True, eq=False)
class MapWalls:
    """n walls. `frame` (n, 3) in the map: x along the wall, seen from y > 0; known from `low` to `high` along x.

    `identity` (n,) never changes for a wall; `observations` (n,) counts keyframes; `covariance` (n, 2, 2) of the offset
    across the wall and of its heading at its frame's origin, NaN where it was not asked for. `pieces`, one (k, 2) a
    wall, are the stretches of it that were seen, from and to along x: between them there may be openings.
    """

    identity: Integers
    frame: Floats
    low: Floats
    high: Floats
    observations: Integers
    covariance: Floats
    pieces: tuple[Floats, ...]

    def __len__(self) -> int:
        return len(self.frame)

    def end_points(self) -> Floats:
        """(n, 2, 2): both end points of each wall in the map, metres."""
        return _along(self.frame, np.stack([self.low, self.high], axis=-1))

    def piece_points(self) -> tuple[Floats, Integers]:
        """(m, 2, 2): both end points of each piece in the map, metres; (m,) which wall it is a piece of."""
        wall = np.repeat(np.arange(len(self)), [len(pieces) for pieces in self.pieces])
        return _along(self.frame[wall], np.concatenate([np.zeros((0, 2)), *self.pieces])), wall


def _along(frame: Floats, extent: Floats) -> Floats:
    """(n, 2, 2): the points at two distances (n, 2) along the x of frames (n, 3)."""
    direction = np.stack([np.cos(frame[:, 2]), np.sin(frame[:, 2])], axis=-1)
    return np.asarray(frame[:, None, :2] + extent[..., None] * direction[:, None, :])


@dataclass(frozen=True, slots=True, eq=False)
class MapCorners:
    """m corners: `position` (m, 2) in the map, `covariance` (m, 2, 2), NaN where not asked for, and
    `lines` (m, 2), the identities of their walls, -1 where unknown."""

    identity: Integers
    position: Floats
    covariance: Floats
    lines: Integers
    observations: Integers

    def __len__(self) -> int:
        return len(self.position)


@dataclass(frozen=True, slots=True, eq=False)
class ScanTracked:
    """A scan was registered: the base's `pose` in the map, what odometry alone says, and the share of the scan's wall
    length that the map explains."""

    stamp: float
    pose: Pose
    odometry: Pose
    overlap_ratio: float
    keyframe: int


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeAdded:
    """A scan became a keyframe. Everything is as the estimate stands after the update.

    pose_covariance (3, 3) in the keyframe's own frame
    points        (p, 2) valid returns in the base's frame, metres
    line_match    (n,) identity of the wall each segment was associated with; -1: none yet
    line_gate     (n,) squared Mahalanobis distance of the nearest candidate, matched or not; NaN where there was none
    line_nearest  (n,) identity of that candidate; -1: none
    corner_match, corner_gate, corner_nearest  the same for corners
    new_lines     identities of walls first seen here
    timings       milliseconds by stage
    counts        sizes of the graph and map
    """

    index: int
    stamp: float
    pose: Pose
    pose_covariance: Floats
    odometry: Pose
    points: Floats
    segments: Segments
    corners: CornerPoints
    line_match: Integers
    line_gate: Floats
    line_nearest: Integers
    corner_match: Integers
    corner_gate: Floats
    corner_nearest: Integers
    new_lines: Integers
    sigma_range: float
    timings: dict[str, float]
    counts: dict[str, int]


@dataclass(frozen=True, slots=True, eq=False)
class MapUpdated:
    """The whole map and path after keyframe `index`; sent every few keyframes and whenever much of it moved.

    `shift` is the largest distance a keyframe moved since the last MapUpdated, metres. The covariances of walls and
    corners are as they were when each was last seen.
    """

    index: int
    stamp: float
    keyframes: Floats
    lines: MapWalls
    corners: MapCorners
    chi2: float
    shift: float


@dataclass(frozen=True, slots=True, eq=False)
class WallsMerged:
    """Two walls turned out to be one: `absorbed` is from now on `kept`."""

    index: int
    stamp: float
    kept: int
    absorbed: int
    gate: float


@dataclass(frozen=True, slots=True, eq=False)
class WallsRemoved:
    """Walls that are no longer where they were: they are not in the map any more. Told with the next MapUpdated."""

    index: int
    stamp: float
    lines: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class GraphInspected:
    """How well every factor fits the estimate after keyframe `index`; sent after closures, at the end, and now and
    then, the seldomer the larger the graph."""

    index: int
    stamp: float
    residuals: Residuals


@dataclass(frozen=True, slots=True)
class LoopTest:
    """A test of a loop: the `value` that had to be `at_least` or at most the `gate`, and whether it `passed`."""

    name: str
    value: float
    gate: float
    at_least: bool
    passed: bool


@dataclass(frozen=True, slots=True, eq=False)
class ComparedWalls:
    """What was compared for a loop, all in the map as it was then, metres.

    recent  (n, 2, 2) both ends of the walls of the last metres; `aligned` (n, 2, 2): the same, moved as the loop has it
    old     (m, 2, 2) both ends of the walls known for long
    match   (n,) row of `old` on which each recent wall would fall; -1: none
    """

    recent: Floats
    aligned: Floats
    old: Floats
    match: Integers


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """What a closure, or taking one back, did to path and map.

    keyframes_before, keyframes  (k, 3) poses before and after
    lines_before                 the walls before
    chi2_before                  robust cost of the graph before
    chi2_strained                with what the closure adds, nothing moved yet; NaN where one was taken back
    chi2                         after
    """

    keyframes_before: Floats
    keyframes: Floats
    lines_before: MapWalls
    chi2_before: float
    chi2_strained: float
    chi2: float

    def shifts(self) -> Floats:
        """(k,) metres by which each keyframe moved."""
        return np.asarray(np.hypot(*(self.keyframes - self.keyframes_before)[:, :2].T))


@dataclass(frozen=True, slots=True, eq=False)
class LoopDecided:
    """What was decided about a place that looked known, after keyframe `index`; of a "retracted" one that is where it
    had been accepted.

    candidate     running number
    old           a keyframe that saw the place before
    motion        [x, y, heading] by which the robot would have to move, in its own frame
    status        "held" (it waits for a second look), "accepted", "rejected", or "retracted": accepted before, and
                  contradicted by what was seen since; `reason` says why
    explained     share of the wall length seen lately, where the old map has been, that would fall on old walls
    matches       walls that would
    runner_up     how much another motion explains, relative to this one
    sigma         metres, in the direction in which the motion is known worst
    contradicted  share of the wall length that old walls would have hidden
    merged        pairs of identities (old, recent) of walls that were made one
    shift         metres by which the keyframe moved
    tests         all that had to hold
    sight         what was compared
    correction    what it did, if it is accepted or retracted
    """

    index: int
    stamp: float
    candidate: int
    old: int
    motion: Pose
    status: str
    reason: str
    overlap_ratio: float
    matches: int
    runner_up: float
    sigma: float
    contradicted: float
    merged: tuple[tuple[int, int], ...]
    shift: float
    tests: tuple[LoopTest, ...] = ()
    sight: ComparedWalls | None = None
    correction: Correction | None = None


@dataclass(frozen=True, slots=True, eq=False)
class GroundTruthReceived:
    """The recording knows the true pose, in the world's frame."""

    stamp: float
    pose: Pose


@dataclass(frozen=True, slots=True, eq=False)
class Notice:
    """Something a person should know: a gap in the data, a jump of the odometry, a scan without features."""

    stamp: float
    text: str
    level: str = "WARN"


@dataclass(frozen=True, slots=True, eq=False)
class StateChanged:
    """How well the robot's place is known from now on: "OK", "DEGENERATE" (along `direction`, radians in the map, by
    odometry alone) or "LOST"."""

    stamp: float
    state: str
    direction: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Relocalised:
    """The robot was recognised somewhere on the map where odometry has not led it: the base is at `pose` there."""

    stamp: float
    pose: Pose


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    """The run is over; the final map with the covariances of its marginals, and the path at every odometry stamp.

    keyframe_covariance (k, 3, 3), each in the keyframe's own frame, of the final estimate; None where nobody asked.
    """

    lines: MapWalls
    corners: MapCorners
    keyframe_stamps: Floats
    keyframes: Floats
    stamps: Floats
    poses: Floats
    summary: dict[str, object] = field(default_factory=dict)
    keyframe_covariance: Floats | None = None


Event: TypeAlias = (
    ScanTracked
    | KeyframeAdded
    | MapUpdated
    | GraphInspected
    | WallsMerged
    | WallsRemoved
    | LoopDecided
    | StateChanged
    | Relocalised
    | GroundTruthReceived
    | Notice
    | Finished
)


class Sink(Protocol):
    """A listener. It must be quick: it is called in the path of a scan."""

    def handle(self, event: Event) -> None:
        """Take one event."""
        ...
