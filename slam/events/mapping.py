"""Events of the map: keyframes, walls, and the factor graph."""

from __future__ import annotations

from drivers.immutable import immutable
from drivers.se2 import Pose

from ..geometry.segments import CornerPoints, Floats, Integers, Segments
from ..graph.residuals import Residuals
from ..mapping.map_features import MapCorners, MapWalls


@immutable
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
    counts           numbers of walls, corners and keyframes in the map, by these names
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


@immutable
class MapUpdated:
    """The whole map after keyframe `index`; published every few keyframes and after a loop closure.

    keyframe_poses  (k, 3) in the map
    walls           walls, `corners` corners, with covariances as they were when each was last seen
    chi2            robust cost of the graph
    dof             degrees of freedom of the graph, its expected cost if the noise is as modelled; 0: unknown
    shift           largest distance a keyframe has moved since the last MapUpdated, metres
    """

    index: int
    stamp: float
    keyframe_poses: Floats
    walls: MapWalls
    corners: MapCorners
    chi2: float
    shift: float
    dof: int = 0


@immutable
class WallsMerged:
    """Two walls were found to be the same, at a squared distance `gate`: `absorbed` is part of `kept` from now on."""

    index: int
    stamp: float
    kept: int
    absorbed: int
    gate: float


@immutable
class WallsRemoved:
    """Walls were removed from the map, as scans have seen through them; published with the next MapUpdated."""

    index: int
    stamp: float
    walls: tuple[int, ...]


@immutable
class GraphInspected:
    """Residuals of all factors after keyframe `index`.

    Published after loop closures, at the end, and at intervals that grow with the graph.
    """

    index: int
    stamp: float
    residuals: Residuals
