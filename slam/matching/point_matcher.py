"""Match all points of a scan to the distance field, near poses that are predicted with a known uncertainty.

Gauss-Newton on the interpolated vectors starts at each prediction, first with a wide kernel, then with a narrow one. If
the best result fits badly, if no odometry narrows the prediction, or if time does not matter, the poses within the
uncertainty of each prediction are searched exhaustively, and the best ones are improved in the same way. Poses are
compared by a cost, minus the logarithm of their likelihood: that of the distances of the points, that of the distance
from the prediction, and the prediction's own. Matches near several predictions are compared by the offsets of points
across the surfaces, and by the beams that pass through known surfaces as well.

A point in a cell that no beam has crossed neither supports a pose nor contradicts it: its cost is UNSEEN. So is that
of a point beside a surface that faces elsewhere: it may be on the other side of a wall, seen for the first time.

Equations: docs/mathematics.md#cost-of-a-pose and docs/mathematics.md#gauss-newton.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers import se2
from drivers.compiled import compiled, inlined
from drivers.immutable import immutable
from drivers.small_matrices import (
    inverse,
    log_determinant,
    product,
    quadratic_form,
    solution,
    without_negative_part,
)
from features.normal_limits import NORMAL_LIMIT

from ..geometry.angles import wrap_angle
from ..geometry.degeneracy import MIN_INFORMATION
from ..geometry.pose_steps import difference, move_back, wrap_heading
from ..geometry.segments import Floats
from ..geometry.significance import MOST
from ..odometry.continuity import MIN_JUMP
from .distance_field import DistanceField
from .interpolation import add_points, memory_for, unbiased_information
from .landmark_equations import MATCH_CAUCHY_SCALE
from .offset_tiles import FIELD_CELL
from .point_costs import COARSE_SIGMA, crossing_beams, fine_cost, points_cost, search_grid
from .scan_points import FINE_SIGMA, subsample

# Metres between points that count as separate measurements. Origin: chosen, as FIELD_CELL.
POINT_SPACING = FIELD_CELL
# Share of the information of a matched scan that is independent of other scans: scans from nearby repeat the errors of
# the surfaces. Origin: measured, on recordings a third is slightly better than a tenth or all of it.
INDEPENDENT_SHARE = 0.3
# Points of one object, which fit or do not fit together. Origin: chosen, a person at a metre or two; not measured.
POINTS_PER_OBJECT = 5.0
# Gauss-Newton steps with each kernel. Origin: numerical, more than are needed; it ends earlier if the steps are small.
MAX_STEPS = 20
# Metres and radians below which a step is the last one. Origin: numerical, far below the accuracy.
LAST_STEP = 1e-4
# Fit below which a match is not accepted. Origin: definition, most of the points in seen space fit.
MIN_FIT = MOST
# Fit below which poses around the prediction are searched. Origin: measured, nine of ten scans of recordings fit
# better.
SEARCH_FIT = 0.85
# Points in seen space that are needed to judge a fit. Origin: chosen; not measured.
MIN_KNOWN_POINTS = 20
# Metres: largest distance of a searched pose from the prediction. Origin: definition, longer motions may be jumps.
MAX_SEARCH_SHIFT = MIN_JUMP
# Radians, likewise. Origin: chosen, for speed: a sparse log turns 40 degrees between two scans.
MAX_SEARCH_TURN = math.radians(60.0)
# Largest number of predictions for which a good match near the first one suffices. If there are more, there is more
# doubt than usual, and the poses around each are searched. Origin: definition, those of odometry, of a slip, and of
# odometry that has caught up; there are more if a pose is tentative.
MAX_UNSEARCHED = 3
# Points of a scan that are searched with. Origin: chosen, for speed; not measured.
MAX_SEARCH_POINTS = 60


@immutable
class Prediction:
    """Prediction of a pose, with a Cauchy kernel of the scale MATCH_CAUCHY_SCALE.

    pose         [x, y, heading] of the base in the map
    information  (3, 3), in its own frame
    cost         minus the logarithm of the probability that the prediction holds at all
    inertia      prediction of an even motion, whose distance is a further cost of a pose, as a robot changes its
                 velocity gradually; None if the velocity is not known
    search_sigmas  (2,) metres and radians: NORMAL_LIMIT times these are searched around the pose; None for the
                 standard deviations of the prediction itself
    """

    pose: se2.Pose
    information: Floats
    cost: float = 0.0
    inertia: Prediction | None = None
    search_sigmas: Floats | None = None

    @property
    def least_cost(self) -> float:
        """Cost of the predicted pose: a wide prediction gives each pose a lower density than a narrow one."""
        return self.cost - 0.5 * float(log_determinant(self.information))

    def cost_of(self, pose: se2.Pose) -> float:
        """Return the cost of a pose."""
        inertia = 0.0 if self.inertia is None else self.inertia._robust(pose)
        return self.least_cost + self._robust(pose) + inertia

    def _robust(self, pose: se2.Pose) -> float:
        """Return the cost of a pose in excess of `least_cost`, without that of `inertia`."""
        return 0.5 * MATCH_CAUCHY_SCALE**2 * math.log1p(self.squared_distance(pose) / MATCH_CAUCHY_SCALE**2)

    def squared_distance(self, pose: se2.Pose) -> float:
        """Return the squared Mahalanobis distance of a pose."""
        return float(_squared_distance(self.pose, self.information, pose))

    def excludes(self, pose: se2.Pose) -> bool:
        """Return True if a pose is more than NORMAL_LIMIT standard deviations away."""
        return self.squared_distance(pose) > NORMAL_LIMIT**2


def information_of(sigmas: Floats) -> Floats:
    """Return the information (3, 3) of a pose whose components have the standard deviations `sigmas` (3,)."""
    information = np.zeros((3, 3))
    information.flat[::4] = sigmas**-2.0
    return information


@immutable
class PointMatch:
    """Match of a scan's points.

    pose         [x, y, heading] of the base in the map
    information  (3, 3) of the pose from the points alone, in the base's frame
    prediction   from which the pose was found
    cost         minus the logarithm of the likelihood, see the module; lower is better
    fit          0 to 1: mean over the points in seen space of 1 - weight * cost / MISFIT
    known        number of points in seen space
    """

    pose: se2.Pose
    information: Floats
    prediction: Prediction
    cost: float
    fit: float
    known: int

    @property
    def poor(self) -> bool:
        """True if there are enough points in seen space, and some of them do not fit."""
        return self.known >= MIN_KNOWN_POINTS and self.fit < SEARCH_FIT


def match_points(
    field: DistanceField, points: Floats, predictions: Sequence[Prediction], *, exhaustive: bool = False
) -> list[PointMatch]:
    """Match points (p, 6) with normals, in the base's frame, to the field near each of several predicted poses.

    Returns the matches, those with the lowest cost first. If the first of up to MAX_UNSEARCHED predictions leads to a
    good match, the poses around them are not searched. If `exhaustive`, they are searched anyway: most of a scan fits
    well at some poses that are a decimetre off, too. A prediction that cannot lead to a lower cost than an earlier one
    is not tried.
    """
    first = match_from(field, points, predictions[0].pose, predictions[0])
    searched = first.known >= MIN_KNOWN_POINTS if exhaustive else first.poor
    if not searched and len(predictions) <= MAX_UNSEARCHED:
        others = [other for other in predictions[1:] if other.least_cost < first.cost]
        return _ranked(field, points, [first, *(match_from(field, points, other.pose, other) for other in others)])
    few = np.ascontiguousarray(subsample(points, MAX_SEARCH_POINTS))  # strided ones would be compiled for separately
    share = len(points) / max(1, len(few)) / POINTS_PER_OBJECT
    matches: list[PointMatch] = []
    for prediction in predictions:
        if any(match.cost <= prediction.least_cost for match in matches):
            continue
        near = first if prediction is first.prediction else match_from(field, points, prediction.pose, prediction)
        start = _search_around(field, few, share, prediction)
        if np.array_equal(start, prediction.pose):
            matches.append(near)
            continue
        tried = (near, match_from(field, points, start, prediction))
        matches.append(min(tried, key=lambda match: match.cost))
    return _ranked(field, points, matches)


def _ranked(field: DistanceField, points: Floats, matches: list[PointMatch]) -> list[PointMatch]:
    """Return matches of points (p, 6), those with the lowest cost first.

    Their costs are those of the prediction, of the points by `fine_cost`, and of the beams through surfaces.
    """
    if len(matches) == 1:
        return matches
    counts = [int(crossing_beams(field.arrays, points, match.pose)) for match in matches]
    share = (min(counts) + 1) / (len(points) + 2)  # mean of its posterior, if all shares are equally probable
    cost = max(0.0, math.log((1.0 - share) / share)) / POINTS_PER_OBJECT
    ranked = []
    for match, count in zip(matches, counts, strict=True):
        of_points = float(fine_cost(field.arrays, points, match.pose)) / POINTS_PER_OBJECT
        ranked.append(replace(match, cost=of_points + match.prediction.cost_of(match.pose) + cost * count))
    return sorted(ranked, key=lambda match: match.cost)


def _search_around(field: DistanceField, points: Floats, share: float, prediction: Prediction) -> se2.Pose:
    """Return the pose with the lowest cost within the uncertainty of a prediction."""
    if prediction.search_sigmas is None:
        covariance = inverse(prediction.information)
        sigma, turn_sigma = math.sqrt(covariance[:2, :2].diagonal().max()), math.sqrt(covariance[2, 2])
    else:
        sigma, turn_sigma = prediction.search_sigmas.tolist()
    shift, turn = min(MAX_SEARCH_SHIFT, NORMAL_LIMIT * sigma), min(MAX_SEARCH_TURN, NORMAL_LIMIT * turn_sigma)
    return np.asarray(
        search_grid(
            field.arrays, points, share,
            prediction.pose, prediction.information, MATCH_CAUCHY_SCALE, shift, turn,
        )
    )  # fmt: skip


def match_from(
    field: DistanceField,
    points: Floats,
    start: se2.Pose,
    prediction: Prediction,
    sigmas: tuple[float, ...] = (COARSE_SIGMA, FINE_SIGMA),
) -> PointMatch:
    """Improve the pose `start` by Gauss-Newton with a kernel of each of the scales `sigmas` (metres) in turn.

    The points (p, 6), with normals, are used as they are.
    """
    pose, information, cost, fit, known = _match_from(
        field.arrays, points, start, prediction.pose, prediction.information, sigmas
    )
    total = cost / POINTS_PER_OBJECT + prediction.cost_of(pose)
    return PointMatch(pose, information, prediction, total, fit, known)


def point_cost(field: DistanceField, points: Floats, pose: se2.Pose) -> tuple[float, float, int]:
    """Return cost, fit and known points of points (p, 6), used as they are, at a pose; see `PointMatch`."""
    cost, fit, known = points_cost(field.arrays, points, pose)
    return float(cost), float(fit), int(known)


def point_information(points: Floats, *, unbiased: bool = False) -> Floats:
    """Return the information (3, 3) of a pose from points (p, 6) with normals in its frame, if each of them is matched.

    The noise of a point is FINE_SIGMA along its normal. A point without a normal measures both directions, without its
    excess (see `surface_points`). The excess of points with a normal is subtracted if the information has to be true,
    `unbiased`, and not only comparable.
    """
    total, excess = _sums_of_squares(points)
    return np.asarray((without_negative_part(total - excess) if unbiased else total) / FINE_SIGMA**2)


@compiled
def _sums_of_squares(points):  # type: ignore[no-untyped-def]
    """Return J' J (3, 3) with the derivatives J of the offsets of points by the pose, and the excess along surfaces."""
    total, excess = np.zeros((3, 3)), np.zeros((3, 3))
    for k in range(len(points)):
        x, y, normal_x, normal_y, of_excess, weight = points[k]
        if normal_x == 0.0 and normal_y == 0.0:
            _add_square(total, x, y, 1.0, 0.0, weight * (1.0 - of_excess))
            _add_square(total, x, y, 0.0, 1.0, weight * (1.0 - of_excess))
        else:
            _add_square(total, x, y, normal_x, normal_y, weight)
            _add_square(excess, x, y, -normal_y, normal_x, weight * of_excess)
    return total, excess


@inlined
def _add_square(total, x, y, unit_x, unit_y, weight):  # type: ignore[no-untyped-def]
    """Add w j j' with the derivative j of the offset of the point (x, y) along a unit vector."""
    row = (unit_x, unit_y, x * unit_y - y * unit_x)
    for k in range(3):
        for m in range(3):
            total[k, m] += weight * row[k] * row[m]


@compiled
def _match_from(field, points, start, prediction, prior, sigmas):  # type: ignore[no-untyped-def]
    """Run Gauss-Newton; return the fields of `PointMatch`, with the cost of the points alone; see `match_from`.

    prediction, prior  pose (3,) in the map and its information (3, 3)
    """
    pose, memory = start.copy(), memory_for(len(points))
    information, gradient, found = np.zeros((3, 3)), np.zeros(3), 0
    robust, total = np.empty((3, 3)), np.empty((3, 3))
    for sigma in sigmas:
        for _ in range(MAX_STEPS):
            found = add_points(pose, points, field, sigma, information, gradient, memory)
            error = difference(prediction, pose)
            scale = 1.0 + quadratic_form(prior, error[0], error[1], error[2]) / MATCH_CAUCHY_SCALE**2
            for k in range(3):
                for m in range(3):
                    robust[k, m] = prior[k, m] / scale
                    total[k, m] = information[k, m] + robust[k, m]
                total[k, k] += MIN_INFORMATION
            x, y, turn = product(robust, error)
            move = solution(total, (gradient[0] + x, gradient[1] + y, gradient[2] + turn))
            move_back(pose, move)
            if abs(move[0]) < LAST_STEP and abs(move[1]) < LAST_STEP and abs(move[2]) < LAST_STEP:
                break
    cost, fit, known = points_cost(field, points, pose)
    wrap_heading(pose)
    return pose, unbiased_information(pose, points, found, sigmas[-1], information, memory), cost, fit, known


@compiled
def _squared_distance(prediction, information, pose):  # type: ignore[no-untyped-def]
    """Return the squared Mahalanobis distance of a pose from a prediction; the information is in the latter's frame."""
    c, s = math.cos(prediction[2]), math.sin(prediction[2])
    x, y = pose[0] - prediction[0], pose[1] - prediction[1]
    return quadratic_form(information, c * x + s * y, c * y - s * x, wrap_angle(pose[2] - prediction[2]))
