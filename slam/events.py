"""Events that the pipeline publishes: plain data, copied out of the estimate, so that a sink may keep them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np

from drivers.se2 import Pose

from .geometry.segments import CornerPoints, Floats, Integers, Segments
from .graph.residuals import Residuals
from .loop_closure.loop_status import LoopStatus
from .mapping.map_features import MapCorners, MapWalls

if TYPE_CHECKING:
    from .odometry.error_model import OdometryModel


@dataclass(frozen=True, slots=True, eq=False)
class ScanTracked:
    """A scan was tracked.

    pose           (3,) of the base in the map
    odometry       (3,) odometry pose at the same time
    overlap_ratio  share of the scan's wall length on known walls, 0 to 1
    keyframe       index of the last keyframe
    points         (p, 2) valid returns in the base's frame, metres
    covariance     (3, 3) of the pose in the map as it stands, in the base's frame; zero: unknown
    odometry_model copy of the error model of odometry as learned so far; None if it is unknown
    """

    stamp: float
    pose: Pose
    odometry: Pose
    overlap_ratio: float
    keyframe: int
    points: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    covariance: Floats = field(default_factory=lambda: np.zeros((3, 3)))
    odometry_model: OdometryModel | None = None


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeAdded:
    """A scan became a keyframe. All values are those after the update of the graph.

    index            number of the keyframe
    pose             (3,) of the base in the map
    pose_covariance  (3, 3) in the keyframe's own frame
    odometry         (3,) odometry pose
    points           (p, 2) valid returns in the base's frame, metres
    segments         n segments, `corners` m corners in the base's frame
    wall_match       (n,) id of the wall that each segment was associated with, -1 if it is ambiguous
    wall_gate        (n,) squared Mahalanobis distance of the nearest wall, matched or not; NaN if there was none
    wall_nearest     (n,) id of that wall, -1 if there was none
    corner_match     (m,) the same for corners, likewise `corner_gate` and `corner_nearest`
    new_walls        ids of the walls first seen here
    sigma_range      estimated standard deviation of a range, metres
    timings          milliseconds by stage
    counts           sizes of graph and map
    """

    index: int
    stamp: float
    pose: Pose
    pose_covariance: Floats
    odometry: Pose
    points: Floats
    segments: Segments
    corners: CornerPoints
    wall_match: Integers
    wall_gate: Floats
    wall_nearest: Integers
    corner_match: Integers
    corner_gate: Floats
    corner_nearest: Integers
    new_walls: Integers
    sigma_range: float
    timings: dict[str, float]
    counts: dict[str, int]


@dataclass(frozen=True, slots=True, eq=False)
class MapUpdated:
    """The whole map after keyframe `index`; published every few keyframes and after a loop closure.

    keyframes  (k, 3) poses
    walls      walls, `corners` corners, with covariances as they were when each was last seen
    chi2       robust cost of the graph
    dof        degrees of freedom of the graph, its expected cost if the noise is as modelled; 0: unknown
    shift      largest distance a keyframe has moved since the last MapUpdated, metres
    """

    index: int
    stamp: float
    keyframes: Floats
    walls: MapWalls
    corners: MapCorners
    chi2: float
    shift: float
    dof: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class WallsMerged:
    """Two walls were found to be the same, at a squared distance `gate`: `absorbed` is part of `kept` from now on."""

    index: int
    stamp: float
    kept: int
    absorbed: int
    gate: float


@dataclass(frozen=True, slots=True, eq=False)
class WallsRemoved:
    """Walls were removed from the map, as scans have seen through them; published with the next MapUpdated."""

    index: int
    stamp: float
    walls: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class GraphInspected:
    """Residuals of all factors after keyframe `index`.

    Published after loop closures, at the end, and at intervals that grow with the graph.
    """

    index: int
    stamp: float
    residuals: Residuals


@dataclass(frozen=True, slots=True)
class LoopCheck:
    """One check of a loop hypothesis: `value` had to be at least (`at_least`) or at most the `gate`."""

    name: str
    value: float
    gate: float
    at_least: bool
    passed: bool


@dataclass(frozen=True, slots=True, eq=False)
class ComparedPoints:
    """Points of the last match of a loop hypothesis, in the map as it was then, metres.

    recent   (n, 2) points of the last keyframes
    aligned  (n, 2) the same, moved by the hypothesis
    old      (m, 2) points of the old place
    """

    recent: Floats
    aligned: Floats
    old: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """Change of trajectory and map by a loop closure or a retraction.

    keyframes_before  (k, 3) poses before
    keyframes         (k, 3) poses after
    walls_before      walls before
    chi2_before       robust cost of the graph before
    chi2_strained     robust cost with the factors of the closure before anything moved; NaN for a retraction
    chi2              robust cost after
    """

    keyframes_before: Floats
    keyframes: Floats
    walls_before: MapWalls
    chi2_before: float
    chi2_strained: float
    chi2: float

    def shifts(self) -> Floats:
        """Return the distance (k,) that each keyframe moved, metres."""
        return np.asarray(np.hypot(*(self.keyframes - self.keyframes_before)[:, :2].T))


@dataclass(frozen=True, slots=True, eq=False)
class LoopDecided:
    """Decision on a loop hypothesis after keyframe `index`.

    A retraction is published later than the closure at that keyframe, and a rejection when the hypothesis is given up,
    40 m of driving after the last look that supports it, or at the end of the run.

    candidate      running number
    old            keyframe that saw the place before
    motion         (3,) [x, y, heading] by which the robot would move, in its own frame
    status         accepted, rejected (a check fails, or the map does not fit together), or retracted (contradicted by
                   later scans)
    reason         reason of the status
    overlap_ratio  share of the recent points in space seen before that fit the old place
    matches        number of looks that support the hypothesis
    runner_up      number of looks that support the strongest rival, as a share of these
    sigma          standard deviation of the motion in its least certain direction, metres
    contradicted   share of the looks that contradict the hypothesis
    merged         pairs of wall ids (old, recent) that were merged
    shift          distance that the keyframe moved, metres
    margin         share of its requirement that the worst check meets, at most 1
    checks         all checks
    compared       points of the last match
    correction     change of trajectory and map, if the status is accepted or retracted
    """

    index: int
    stamp: float
    candidate: int
    old: int
    motion: Pose
    status: LoopStatus
    reason: str
    overlap_ratio: float
    matches: int
    runner_up: float
    sigma: float
    contradicted: float
    merged: tuple[tuple[int, int], ...]
    shift: float
    margin: float = 1.0
    checks: tuple[LoopCheck, ...] = ()
    compared: ComparedPoints | None = None
    correction: Correction | None = None


@dataclass(frozen=True, slots=True, eq=False)
class GroundTruthReceived:
    """The recording contains the true pose, in the frame of the world."""

    stamp: float
    pose: Pose


@dataclass(frozen=True, slots=True, eq=False)
class Notice:
    """A message for the user, for example about a gap in the data, a jump of the odometry, or a lost pose."""

    stamp: float
    text: str
    level: str = "WARN"


@dataclass(frozen=True, slots=True, eq=False)
class StateChanged:
    """The localisation status changed to OK, DEGENERATE or LOST.

    If DEGENERATE, `direction` (radians in the map, 0 to pi) is the one in which only odometry determines the position.
    """

    stamp: float
    state: str
    direction: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Relocalised:
    """A lost or kidnapped robot was recognised in the map; the base is at `pose` (3,).

    The keyframes from `first` on, which it has mapped since then, are in their places in the map now.
    """

    stamp: float
    pose: Pose
    first: int


@dataclass(frozen=True, slots=True, eq=False)
class SuspectFound:
    """A check of the finished run found a contradiction at `stamp`; published at the end of the run, worst first.

    index     last keyframe at that time
    text      sentence with the figures
    position  (2,) in the final map, metres
    """

    index: int
    stamp: float
    text: str
    position: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    """The run is over: final map and trajectory.

    walls, corners       walls and corners with marginal covariances
    keyframe_stamps      (k,) seconds
    keyframes            (k, 3) poses
    stamps               (m,) seconds of all odometry readings
    poses                (m, 3) of the base in the map at these stamps
    summary              counts, timings and learned values, as plain data
    keyframe_covariance  (k, 3, 3) in each keyframe's own frame; None if they were not requested
    """

    walls: MapWalls
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
    | SuspectFound
    | Finished
)


class Sink(Protocol):
    """Receiver of events. It must return quickly: it is called while a scan is processed.

    A sink with an attribute `handled`, a tuple of types of events, receives only those. Events that no sink receives
    are not built: a summary of the whole map takes tens of milliseconds.
    """

    def handle(self, event: Event) -> None:
        """Handle one event."""
        ...
