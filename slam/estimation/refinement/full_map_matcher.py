"""Match scans to the whole map: to its walls, and to the points of all keyframes nearby.

The points are those of keyframes whose relative pose is well known, as while driving: of passes through one place,
those that are linked. If the robot came back and no loop was closed, the surfaces of the earlier pass are elsewhere by
the drift. Together with those of the scan's own pass they would pull it from its path, and the path would tear.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.compiled import compiled
from drivers.immutable import immutable
from drivers.small_matrices import inverse, quadratic_form

from ...geometry.angles import wrap_angle
from ...geometry.roughness import Roughness
from ...geometry.segments import Floats, Integers
from ...geometry.surroundings import INDOOR_RANGE, ROOM_SIZE
from ...localisation.local_field import REFERENCE_DISTANCE
from ...localisation.match_target import MatchTarget
from ...localisation.path_distances import PathDistances
from ...localisation.slip_statistics import SlipStatistics
from ...localisation.small_objects import SmallObjects
from ...mapping.landmarks import Landmarks
from ...mapping.local_map import LOCAL_MAP_MARGIN, LocalMap, landmarks_around
from ...matching.distance_field import DistanceField
from ...matching.landmark_equations import MATCH_CAUCHY_SCALE
from ...matching.line_matcher import Registration
from ...matching.point_matcher import PointMatch, Prediction
from ...matching.scan_features import ScanFeatures
from ...odometry.error_model import OdometryModel
from ...odometry.measurement_clock import MeasurementClock
from ...preprocessing.scan_sequence import ScanSequence
from .even_motions import TRACKED_SIGMAS, even_informations, fractions_of
from .scan_history import WRONG_ODOMETRY_SIGMAS, ScanHistory

# Metres; side of the square tiles: scans of one tile use the same distance field.
# Origin: definition, they show mostly the same surfaces.
TILE = REFERENCE_DISTANCE
# Metres from the centre of a tile to each side of its field: what is seen from the border of the tile.
# Origin: definition.
FIELD_HALF_WIDTH = INDOOR_RANGE + 0.5 * TILE
# Metres from the centre of a tile within which keyframes contribute points to its distance field.
# Origin: definition.
FIELD_RADIUS = ROOM_SIZE
# Maximum number of keyframes per distance field, evenly selected. Origin: chosen, bounds the time; not measured.
MAX_FIELD_KEYFRAMES = 40
# Distance fields that are kept, those needed again soonest: the robot returns to tiles.
# Origin: measured on three recordings, a field has some 1.5 MB. If twice as many are kept, two thirds to three quarters
# as many are built. This saves 0.3 to 0.8 % of the time of a run, and takes up to 21 MB more at its peak.
MAX_FIELDS = 16

_Square: TypeAlias = tuple[int, int, int]
"""Column and row of a tile, and group of parts of the map."""
_Tile: TypeAlias = tuple[_Square, int, int]
"""Square, first keyframe of the passes of which the field has points, and 0 or 1 for even or odd keyframes."""


@immutable
class FullMapMatch:
    """Match of a scan to the whole map.

    points          match of its points
    registration    of its features with the landmarks
    plausible       False if the scan does not fit the map
    odometry_wrong  True if the scan fits better on an even motion between its neighbours than at its present pose
    """

    points: PointMatch
    registration: Registration
    plausible: bool
    odometry_wrong: bool


class FullMapMatcher:
    """Landmarks, and the points of keyframes at `poses` (k, 3), to which scans are matched.

    path_distances  between the keyframes
    roughness       of the walls
    range_bias      metres, without which the landmarks were estimated
    model           of odometry's errors
    odometry_wrong  (n,) true for scans at which odometry is known to be wrong
    """

    def __init__(
        self,
        history: ScanHistory,
        landmarks: Landmarks,
        poses: Floats,
        path_distances: PathDistances,
        roughness: Roughness,
        range_bias: float,
        model: OdometryModel,
        odometry_wrong: NDArray[np.bool_],
    ) -> None:
        self._history, self._landmarks, self._poses, self._roughness = history, landmarks, poses, roughness
        self._odometry_wrong, self.motions = odometry_wrong, history.motions(model)
        self._neighbours, self._motions_to, self._motion_informations = _from_neighbours(
            *self.motions.known(odometry_wrong), self.motions.unmeasured
        )
        self._slip_cost = SlipStatistics(len(history), int(odometry_wrong.sum())).cost
        self._informations = history.informations + np.diag(WRONG_ODOMETRY_SIGMAS**-2)
        self._range_bias = range_bias
        self._small_objects = SmallObjects()
        self._groups = landmarks.parts.groups_of(np.arange(len(poses)))
        self._path_distances = path_distances
        self._passes = lru_cache(maxsize=None)(self._passes_through)
        self._tiles = self._tiles_of(history.own_keyframes)
        self._next_rows = _next_rows(self._tiles)
        self._fields: dict[_Tile, tuple[int, DistanceField]] = {}  # with the next scan that needs it
        self._points: dict[int, NDArray[np.float32]] = {}  # of the keyframes in fields
        self._stored = lru_cache(maxsize=1)(ScanSequence.of(history.scans).features)  # of a scan: unpacked once
        self._last_keyframe = (np.searchsorted(history.keyframes, np.arange(len(history)), side="right") - 1).tolist()
        clock = MeasurementClock()
        self._intervals = [clock.interval(stamp) for stamp in history.stamps.tolist()]  # to each scan
        self._fractions = fractions_of(self._intervals)
        self._even_informations = even_informations(self._intervals, self._fractions, self._informations)

    def local_map(self, row: int, pose: se2.Pose) -> LocalMap:
        """Return the landmarks that a scan may observe from `pose`: those that existed at that time."""
        reach = LOCAL_MAP_MARGIN + self._stored(row).segments.reach()
        return landmarks_around(self._landmarks, pose, reach, keyframe=self._last_keyframe[row])

    def features(self, row: int) -> ScanFeatures:
        """Return the features of a scan without the range bias."""
        return self._stored(row).without_range_bias(self._range_bias)

    def match(self, row: int, poses: Floats, local_map: LocalMap) -> FullMapMatch:
        """Match the scan `row`, given the poses (n, 3) of all scans and the landmarks around it.

        To match the scans in another order than that of their rows takes more time, as distance fields are built again.
        The share of small objects that have moved is learned from the scans matched before.
        The poses within the uncertainty of its present pose are searched. If an even motion between its neighbours
        leads outside of these, the poses around that are searched as well, at the cost that a slip has in tracking.
        """
        scan = self.features(row)
        target = MatchTarget(local_map, self._field(row), self._roughness)
        present = Prediction(poses[row], self._prior(row, poses))
        cost = 0.0 if self._odometry_wrong[row] else self._slip_cost
        even = Prediction(self._interpolate(row, poses), self._even_informations[row], cost)
        predictions = [present, even] if present.excludes(even.pose) else [present]
        points = self._small_objects.weighted_points(scan)
        earlier_evidence = None if self._odometry_wrong[row] else 0.0
        match = target.match(scan, predictions, points, exhaustive=True, earlier_evidence=earlier_evidence)
        if match.plausible:
            self._small_objects.add(scan, match.points.pose, target.field, self._intervals[row])
        odometry_wrong = match.plausible and match.points.prediction is even
        return FullMapMatch(match.points, match.registration, match.plausible, odometry_wrong)

    def _prior(self, row: int, poses: Floats) -> Floats:
        """Return the information (3, 3) of a scan's present pose.

        In directions that the match while driving did not determine, such as along a corridor, it is that of odometry
        since the neighbouring scan, as far as odometry leads to the present pose. A scan that was not matched and to
        which odometry does not lead has the uncertainty of wrong odometry in all directions.
        """
        neighbour, information = poses[self._neighbours[row]], self._informations[row]
        return np.asarray(
            _prior(neighbour, poses[row], self._motions_to[row], self._motion_informations[row], information)
        )

    def covariance(self, registration: Registration) -> Floats:
        """Return the covariance (3, 3) of a matched pose, in the base's frame."""
        information = registration.information + registration.point_information + np.diag(TRACKED_SIGMAS**-2)
        return np.asarray(np.linalg.inv(information))

    def _interpolate(self, row: int, poses: Floats) -> se2.Pose:
        """Return a scan's pose if the base moved evenly from the previous scan to the next one."""
        if not 0 < row < len(poses) - 1:
            return np.asarray(poses[row], dtype=np.float64)
        motion = se2.between(poses[row - 1], poses[row + 1])
        return se2.compose(poses[row - 1], self._fractions[row] * motion)

    def _tiles_of(self, keyframes: Integers) -> list[_Tile]:
        """Return the tile of the distance field for scans at some keyframes (n,): without the keyframe itself.

        With its own points in the field a scan would stay where it is.
        """
        # The first keyframe, at the map's origin, is in the middle of a tile: rounding errors do not change its tile.
        columns, rows = np.rint(self._poses[:, :2] / TILE).astype(int).T.tolist()
        squares = list(zip(columns, rows, self._groups.tolist(), strict=True))
        tiles = [(squares[k], self._passes(squares[k])[k], 1 - k % 2) for k in range(len(squares))]
        return [tiles[k] for k in keyframes.tolist()]

    def _passes_through(self, square: _Square) -> dict[int, int]:
        """Return the keyframes whose points are in the fields of a square, each with the first one of linked passes."""
        column, row, group = square
        distances = np.hypot(*(self._poses[:, :2] - TILE * np.array([column, row])).T)
        near = np.flatnonzero((distances < FIELD_RADIUS) & (self._groups == group))
        return {k: int(linked[0]) for linked in self._path_distances.divide(near) for k in linked.tolist()}

    def _field(self, row: int) -> DistanceField:
        """Return the distance field for a scan."""
        tile, next_row = self._tiles[row], self._next_rows[row]
        _, field = self._fields.pop(tile, (row, None))
        if field is None:
            field = self._built_field(tile)
        if next_row < len(self._tiles):
            if len(self._fields) == MAX_FIELDS:
                del self._fields[max(self._fields, key=lambda kept: self._fields[kept][0])]
            self._fields[tile] = next_row, field
        return field

    def _built_field(self, tile: _Tile) -> DistanceField:
        """Return the distance field of a tile."""
        square, first, parity = tile
        centre = TILE * np.array(square[:2])
        field = DistanceField.empty(centre, FIELD_HALF_WIDTH)
        near = np.array(
            [k for k, of in self._passes(square).items() if of == first and k % 2 == parity], dtype=np.int64
        )
        near = np.sort(near)[:: max(1, -(-len(near) // MAX_FIELD_KEYFRAMES))]
        field.insert_scans(self._poses[near], [self._points_of(keyframe) for keyframe in near.tolist()])
        return field.completed()

    def _points_of(self, keyframe: int) -> NDArray[np.float32]:
        """Return the points (p, 6) of a keyframe with their normals: it is in several fields."""
        if keyframe not in self._points:
            scan = self._history.scans[self._history.keyframes[keyframe]].features
            self._points[keyframe] = scan.surface_points().astype(np.float32)  # as while driving
        return self._points[keyframe]


def _next_rows(tiles: Sequence[_Tile]) -> list[int]:
    """Return for each of n scans the next one with the same tile, n if there is none."""
    upcoming: dict[_Tile, int] = {}
    following = []
    for row in range(len(tiles) - 1, -1, -1):
        following.append(upcoming.get(tiles[row], len(tiles)))
        upcoming[tiles[row]] = row
    return following[::-1]


def _from_neighbours(
    motions: Floats, covariances: Floats, unmeasured: NDArray[np.bool_]
) -> tuple[Integers, Floats, Floats]:
    """Return a neighbour (n,) of each scan, the motions (n, 3) from there by odometry, and their information (n, 3, 3).

    The neighbour is the scan before. It is the one after if there is none before, or if odometry does not lead from
    there, as after kidnapping.

    motions, covariances  (n - 1, 3), (n - 1, 3, 3) by odometry from each scan to the next
    unmeasured            (n - 1,) true for motions that odometry did not measure
    """
    count = len(motions) + 1
    neighbours = np.arange(count) - 1
    to_scan, informations = np.zeros((count, 3)), np.zeros((count, 3, 3))
    to_scan[1:], informations[1:] = motions, np.linalg.inv(covariances)
    from_next = np.flatnonzero(np.concatenate([[True], unmeasured])[:-1])  # the last scan has no scan after it
    neighbours[from_next] = from_next + 1
    to_scan[from_next], informations[from_next] = se2.inverse(motions[from_next]), informations[from_next + 1]
    return np.maximum(neighbours, 0), to_scan, informations


@compiled
def _prior(neighbour, present, motion, motion_information, information):  # type: ignore[no-untyped-def]
    """Return the information (3, 3) of the pose `present`; see `FullMapMatcher._prior`.

    neighbour           (3,) pose of a neighbouring scan
    motion              (3,) of odometry from there
    motion_information  (3, 3) of this motion
    information         (3, 3) of the match while driving, and that of wrong odometry
    """
    heading = neighbour[2] + motion[2]
    c, s = math.cos(neighbour[2]), math.sin(neighbour[2])
    x, y = neighbour[0] + c * motion[0] - s * motion[1], neighbour[1] + s * motion[0] + c * motion[1]
    c, s = math.cos(heading), math.sin(heading)
    x, y = present[0] - x, present[1] - y
    turn = wrap_angle(present[2] - heading)
    squared = quadratic_form(motion_information, c * x + s * y, c * y - s * x, turn)
    weight = 1.0 / (1.0 + squared / MATCH_CAUCHY_SCALE**2)
    covariance = inverse(information + weight * motion_information)
    for k in range(3):
        covariance[k, k] += TRACKED_SIGMAS[k] ** 2
    return inverse(covariance)
