"""The factor graph: keyframes, walls and corners as variables, odometry and observations as factors.

A wall is a Pose2: a frame on it with x along the wall. An observation of a wall is two BetweenFactorPose2: one measures
only the wall's heading, the other only its offset at the observed segment. Neither has information along the wall.
GTSAM's Pose2 uses the full exponential map, in which an offset along the wall times the error in heading leaks into the
offset across it. The offset is therefore measured from the predicted heading, not from the observed one: then the leak
is of second order, whereas the noise of the observed heading would give information along a bare corridor, and pull the
robot back. A corner is a Point2 observed by bearing and range with a full covariance. All arithmetic is GTSAM's, or the
same on arrays (`array_graph`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, L, P, X

from drivers import se2

from ..errors import MapError, first_line
from ..geometry.segments import Floats
from .factors import MATCH_KINDS, OBSERVATION_KINDS, Factor, FactorKind
from .graph_estimate import GraphEstimate
from .gtsam_factors import from_pose2, to_gtsam_graph, to_pose2
from .wall_segments import WallSegment

# Maximum of updates of `update_until_converged`; the first one moves by what was below the relinearisation threshold.
# Origin: numerical, the fifth update moves everything by less than a micrometre.
MAX_CONVERGING_UPDATES = 5
# The same while a loop is closed, within one keyframe: the rest, a centimetre or so, follows in later updates.
# Origin: measured, closing a loop takes a third of the time.
CLOSING_UPDATES = 2
# Metres and radians, norm over all variables: the estimate has converged if an update changes it by less.
# Origin: numerical, far below any covariance.
CONVERGED_CHANGE = 1e-5
# Metres; standard deviation of the prior on a wall frame's position along the wall, which no observation measures.
# Origin: numerical, weak.
GAUGE_PRIOR_SIGMA = 0.1
# Metres, metres, radians: the first keyframe defines the map's frame. Origin: numerical, far below what is measured.
FIRST_POSE_SIGMAS = np.array([1e-4, 1e-4, 1e-5])
# Metres across and radians: standard deviations of a wall equality. Origin: chosen; not measured.
SAME_WALL_SIGMAS = np.array([5e-3, 3e-3])
# Slope of observations that do not depend on the range bias. Origin: definition.
NO_SLOPE = np.zeros(2)


@dataclass(slots=True, eq=False)
class Additions:
    """Factors, and initial values of new variables, that wait for the next update of a graph."""

    factors: list[Factor] = field(default_factory=list)
    values: gtsam.Values = field(default_factory=gtsam.Values)


class FactorGraph(GraphEstimate):
    """The estimate of trajectory and map.

    Additions are collected in `additions` and take effect with `update`. Poses are [x, y, heading] in metres and
    radians; variables are addressed by keyframe index and landmark id.
    """

    def __init__(self) -> None:
        super().__init__()
        self.additions = Additions()

    # --- additions

    def add_first_keyframe(self, pose: se2.Pose, index: int = 0) -> None:
        """Add the first keyframe of a map, or of a part of it that is not connected yet: it defines the frame."""
        self.additions.values.insert(X(index), to_pose2(pose))
        self._add(FactorKind.POSE_PRIOR, index, index, pose, np.diag(FIRST_POSE_SIGMAS**2))

    def add_keyframe(self, index: int, pose: se2.Pose, start: int, motion: se2.Pose, covariance: Floats) -> None:
        """Add a keyframe with the initial value `pose`, and the `motion` to it from the keyframe `start`.

        covariance  (3, 3) of the motion, in the frame at its end
        """
        self.additions.values.insert(X(index), to_pose2(pose))
        self._add(FactorKind.ODOMETRY, start, index, motion, covariance)

    def add_wall(self, keyframe: int, wall: int, frame: se2.Pose, predicted: se2.Pose) -> None:
        """Add a wall with the initial value `frame` in the map, and its gauge prior.

        The prior fixes the frame along the wall weakly at `predicted`, the frame as seen from the keyframe. It has no
        robust kernel: no measurement determines this direction.
        """
        self.additions.values.insert(L(wall), to_pose2(frame))
        self._add(FactorKind.GAUGE_PRIOR, keyframe, wall, predicted, np.array([[GAUGE_PRIOR_SIGMA**2]]))

    def add_wall_observation(
        self,
        keyframe: int,
        wall: int,
        frame: se2.Pose,
        covariance: Floats,
        predicted: se2.Pose,
        bias_slope: Floats = NO_SLOPE,
    ) -> None:
        """Add a segment of a wall, observed in a keyframe, as two factors.

        frame       of the segment, in the keyframe's frame
        covariance  (2, 2) of its offset across the wall and its heading, at that frame
        predicted   the wall's own frame in the keyframe's frame, by the present estimate
        bias_slope  (2,) offset and heading at the segment's frame per metre of range bias

        With d the offset and h the heading of the wall relative to the prediction, a segment whose centre is l metres
        along the wall measures h and d + l h. The errors of both are correlated: given the error of h, the expected
        error of the offset is k = C_dh / C_hh times that. So the second factor is d + (l - k) h, which is independent
        of the first.
        """
        along, offset, turn = se2.between(predicted, frame).tolist()
        (offset_variance, mixed), (_, turn_variance) = covariance.tolist()
        of_offset, of_turn = bias_slope.tolist()
        k = mixed / turn_variance
        self._add(FactorKind.WALL_HEADING, keyframe, wall, frame, np.array([[turn_variance]]), np.array([of_turn]))
        measured = np.array([*se2.compose(predicted, [0.0, offset - k * turn, 0.0]).tolist(), along - k])
        variance = np.array([[offset_variance - k * mixed]])
        self._add(FactorKind.WALL_OFFSET, keyframe, wall, measured, variance, np.array([of_offset - k * of_turn]))

    def add_corner(self, corner: int, position: Floats) -> None:
        """Add a corner with the initial value `position` (2,) in the map."""
        self.additions.values.insert(C(corner), np.asarray(position, dtype=np.float64))

    def add_corner_observation(
        self, keyframe: int, corner: int, position: Floats, covariance: Floats, bias_slope: Floats = NO_SLOPE
    ) -> None:
        """Add a corner's `position` (2,) in a keyframe's frame, with its covariance (2, 2).

        `bias_slope` (2,) is its motion per metre of range bias.
        """
        self._add(FactorKind.CORNER, keyframe, corner, position, covariance, bias_slope)

    def add_wall_equality(self, wall: int, other: int, along: float) -> None:
        """Constrain two walls to be one: `other`'s frame lies on `wall`, `along` metres from its frame.

        No robust kernel: the decision that they are one has been made.
        """
        self._add(FactorKind.WALL_EQUALITY, wall, other, np.array([along, 0.0, 0.0]), np.diag(SAME_WALL_SIGMAS**2))

    def add_keyframe_prior(self, keyframe: int, pose: se2.Pose, covariance: Floats) -> Factor:
        """Add the `pose` of a keyframe in the map, without a robust kernel, and return the factor.

        covariance  (3, 3) in the keyframe's frame
        """
        return self._add(FactorKind.POSE_PRIOR, keyframe, keyframe, pose, covariance)

    def add_plan_wall(self, wall: int, frame: se2.Pose, covariance: Floats) -> None:
        """Add the `frame` of a wall in the map by a plan, near the wall's own, with the covariance (2, 2) there."""
        self._add(FactorKind.PLAN_WALL, wall, wall, frame, covariance)

    def add_pinned_pose(self, keyframe: int, pose: se2.Pose, covariance: Floats) -> None:
        """Add the surveyed `pose` of a keyframe in the map, with its covariance (3, 3) in the keyframe's frame."""
        self._add(FactorKind.PINNED_POSE, keyframe, keyframe, pose, covariance)

    def add_pinned_wall(self, wall: int, frame: se2.Pose, covariance: Floats) -> None:
        """Add the surveyed `frame` of a wall in the map, near the wall's own, with the covariance (2, 2) there."""
        self._add(FactorKind.PINNED_WALL, wall, wall, frame, covariance)

    def add_loop(self, old: int, keyframe: int, relative: se2.Pose, covariance: Floats) -> Factor:
        """Add a keyframe's pose relative to an old one, without a robust kernel, and return the factor.

        covariance  (3, 3) in the keyframe's frame
        """
        return self._add(FactorKind.LOOP, old, keyframe, relative, covariance)

    def add_point_map(self, keyframe: int, covariance: Floats) -> None:
        """Add the points of a keyframe as a body that scans are matched with, unless that has been done.

        All these matches share the noise of the keyframe's own scan, `covariance` (3, 3) in its frame, which therefore
        is a variable of the graph. Otherwise it would count as many independent errors.
        """
        if not self.has_point_map(keyframe):
            self.additions.values.insert(P(keyframe), to_pose2(self.keyframe_pose(keyframe)))
            self._add(FactorKind.POINT_MAP, keyframe, keyframe, np.zeros(3), covariance)

    def has_point_map(self, keyframe: int) -> bool:
        """Return True if the points of a keyframe have been added as a body, see `add_point_map`."""
        key = P(keyframe)
        return bool(self.additions.values.exists(key) or self.solver.isam.valueExists(key))

    def add_matches(self, matches: Iterable[Factor]) -> None:
        """Add `matches` of another graph; see there. Their keyframes must have been added."""
        for match in matches:
            if match.kind is FactorKind.POINT_MAP:
                self.add_point_map(match.first, match.covariance)
            else:
                self.additions.factors.append(match)

    def add_scan_match(self, old: int, keyframe: int, relative: se2.Pose, covariance: Floats) -> None:
        """Add a keyframe's pose relative to the points of an old one, see `add_point_map`.

        covariance  (3, 3) in the keyframe's frame, of the noise of its own scan
        """
        self._add(FactorKind.SCAN_MATCH, old, keyframe, relative, covariance)

    def add_submap_match(self, old: int, keyframe: int, relative: se2.Pose, covariance: Floats) -> None:
        """Add a keyframe's pose relative to an old one by the points around both.

        covariance  (3, 3) in the keyframe's frame
        """
        self._add(FactorKind.SUBMAP_MATCH, old, keyframe, relative, covariance)

    def _add(
        self,
        kind: FactorKind,
        first: int,
        second: int,
        measured: Floats,
        covariance: Floats,
        bias_slope: Floats = NO_SLOPE[:0],
    ) -> Factor:
        factor = Factor(kind, int(first), int(second), measured, covariance, bias_slope)
        self.additions.factors.append(factor)
        return factor

    def keyframe_pose(self, index: int) -> se2.Pose:
        """Return a keyframe's pose in the map, also of one that waits for `update`."""
        if self.additions.values.exists(X(index)):
            return from_pose2(self.additions.values.atPose2(X(index)))
        return super().keyframe_pose(index)

    def is_waiting(self, keyframe: int) -> bool:
        """Return True if a keyframe waits for `update`."""
        return bool(self.additions.values.exists(X(keyframe)))

    def keyframe_poses(self, count: int) -> Floats:
        """Return the poses (count, 3) of the first `count` keyframes; the last ones may wait for `update`."""
        waiting = next((k for k in range(count) if not self.additions.values.exists(X(count - 1 - k))), count)
        poses = [self.keyframe_pose(k) for k in range(count - waiting, count)]
        return np.vstack([super().keyframe_poses(count - waiting), *poses])

    # --- solving

    def update(self) -> None:
        """Solve with all additions since the last update.

        Raises MapError if the geometry leaves a variable undetermined.
        """
        self._update()

    def _update(self, *, relinearize: bool = False, remove: Sequence[int] = ()) -> None:
        """Pass the additions to the solver; for the arguments see there."""
        self.solver.update(self.additions.factors, self.additions.values, relinearize=relinearize, remove=remove)
        self.additions = Additions()

    def update_until_converged(self, max_updates: int = MAX_CONVERGING_UPDATES) -> None:
        """Update and relinearise until the estimate has converged, at most `max_updates` times."""
        distance = np.inf  # from the estimate to the point at which its variables were linearised
        for _ in range(max_updates):
            self._update(relinearize=True)
            before, distance = distance, self.solver.step_length()
            if abs(distance - before) < CONVERGED_CHANGE:
                return

    def remove_factors(self, factors: Iterable[Factor]) -> None:
        """Remove factors that the graph has been solved with."""
        removed = set(factors)
        self._remove_if(lambda factor: factor in removed)

    def remove_matches(self, since: int, last: int) -> None:
        """Remove the scan and submap matches of keyframes from `since` on with keyframes up to `last`."""
        self._remove_if(lambda f: f.kind in MATCH_KINDS and f.first <= last and f.second >= since)

    def remove_wall_observations(self, since: Mapping[int, int]) -> None:
        """Remove the observations of each of some misassociated walls by keyframes from `since[wall]` on."""
        self._remove_if(lambda f: f.kind in OBSERVATION_KINDS and f.second in since and f.first >= since[f.second])

    def _remove_if(self, condition: Callable[[Factor], bool]) -> None:
        """Remove the factors that satisfy a condition."""
        numbers = [number for number, factor in self.solver.factors.items() if condition(factor)]
        self._update(relinearize=True, remove=numbers)

    def move_wall_segments(self, moves: Sequence[tuple[int, se2.Pose, Sequence[WallSegment]]]) -> None:
        """Make some segments observations of new walls instead of those they belong to, and update.

        `moves` are the id and the frame (3,) of each new wall, and its segments.
        """
        removed: list[int] = []
        for wall, frame, segments in moves:
            for k, segment in enumerate(segments):
                predicted = se2.between(self.keyframe_pose(segment.keyframe), frame)
                if k == 0:
                    self.add_wall(segment.keyframe, wall, frame, predicted)
                self.add_wall_observation(
                    segment.keyframe, wall, segment.frame, segment.covariance, predicted, segment.bias_slope
                )
                removed += segment.numbers
        self._update(relinearize=True, remove=removed)

    def solve_batch(self) -> None:
        """Optimise everything added to an empty graph with Levenberg-Marquardt, and continue from that estimate.

        Raises MapError if the geometry leaves a variable undetermined.
        """
        try:
            factors = to_gtsam_graph(self.additions.factors, self.solver.range_bias.metres)
            self.additions.values = gtsam.LevenbergMarquardtOptimizer(factors, self.additions.values).optimize()
        except RuntimeError as error:
            raise MapError(f"the map cannot be estimated: {first_line(error)}") from error
        self.update()

    # --- copying

    def __deepcopy__(self, memo: dict[int, object]) -> FactorGraph:
        """Return an independent graph with the same estimate, and with what waits for `update`."""
        other = FactorGraph()
        other.solver, other.wall_bends = self.solver.copy(), self.wall_bends
        other.additions = Additions(list(self.additions.factors), gtsam.Values(self.additions.values))
        return other
