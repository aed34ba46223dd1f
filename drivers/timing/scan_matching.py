"""Motion of a lidar between two scans by point-to-line matching, without odometry.

The rotation is found first, by comparing the ranges of the two scans at all rotations; iterated closest points refine
it together with the translation:

    minimise  sum_i log(1 + e_i^2 / s^2),    e_i = n_i . (R p_i + t - q_i)

over the pose (R, t), with q_i the reference point nearest to point p_i and n_i the normal of its surface. The Cauchy
likelihood of scale s admits points that only one of the scans has seen.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .. import se2
from ..compiled import compiled, inlined
from ..immutable import immutable
from ..messages import Floats, Scan
from ..small_matrices import inverse, solution

# Radians, width of a direction bin in the search for the rotation.
# Origin: chosen, at 5 m it is 10 cm, from where iterated closest points converge; not measured.
BIN = 0.02
# Radians, largest rotation between two scans that is found. Origin: chosen, 4 rad/s at 5 Hz; not measured.
MAX_ROTATION = 0.8
# The same in bins. Origin: definition.
MAX_ROTATION_STEPS = round(MAX_ROTATION / BIN)
# Metres, difference of two ranges from which on they count as of different objects. Origin: chosen; not measured.
MAX_RANGE_STEP = 0.3
# Metres, scale of the likelihood: noise of a cheap lidar's range. Origin: chosen; not measured.
SCALE = 0.03
# Metres, largest distance of corresponding points: first and last, and the factor from one iteration to the next.
# Origin: chosen, from the error of the search down to three times the scale; not measured.
FIRST_REACH, LAST_REACH, REACH_FACTOR = 0.5, 0.1, 0.7
# Iterations at most; matching converges in about ten. Origin: numerical.
MAX_ITERATIONS = 25
# Metres and radians: change of the pose at which matching has converged. Origin: numerical.
CONVERGED = 1e-5
# Points of a scan that are matched; more cost time without changing the result. Origin: chosen; not measured.
MAX_POINTS = 200
# Points of the reference at most: half a degree apart, which at 10 m is within the last reach. Errors are measured
# along normals, so denser points do not change them; matching takes time in proportion. Origin: geometry, 360 / 0.45.
MAX_REFERENCE_POINTS = 800
# Corresponding points at least. Origin: chosen, a wall and a corner; not measured.
MIN_CORRESPONDENCES = 20
# Beams to either side from which the normal of a surface is determined. Origin: chosen; not measured.
NORMAL_SPAN = 2
# Added to the diagonal of a match's information, so that it can be inverted if nothing determines a direction.
# Origin: numerical.
REGULARISATION = 1e-9


@immutable
class Surface:
    """Points of a scan with normals, as reference of a match.

    points, normals  (n, 2) by increasing x; unit normals
    order            (n,) place of each point in the order of the bearings
    """

    points: Floats
    normals: Floats
    order: NDArray[np.int64]


@immutable
class Match:
    """Result of matching a scan to a reference.

    pose   [x, y, heading] of the scan in the reference's frame
    sigma  standard deviation of its heading, radians, from the residuals
    cost   negative log-likelihood per point, in units of half a squared normalised residual
    """

    pose: se2.Pose
    sigma: float
    cost: float


def scan_points(scan: Scan, twist: Floats | None = None) -> Floats:
    """Return the valid returns (n, 2) in the lidar's frame in the middle of the sweep, metres.

    twist  (3,) velocity of the lidar [m/s, m/s, rad/s] during the sweep, for de-skewing; None leaves it out
    """
    valid = np.isfinite(scan.ranges) & (scan.ranges > 0.0)
    ranges, bearings = scan.ranges[valid], scan.angles[valid]
    shift = np.zeros((len(ranges), 2))
    if twist is not None:
        since_middle = scan.time_offsets[valid] - middle_offset(scan)
        bearings = bearings + twist[2] * since_middle
        shift = since_middle[:, None] * twist[:2]
    return np.asarray(ranges[:, None] * np.column_stack([np.cos(bearings), np.sin(bearings)]) + shift)


def middle_offset(scan: Scan) -> float:
    """Return the time from a scan's stamp to the middle of its sweep, seconds; it does not depend on the beam order."""
    offsets = scan.time_offsets
    return 0.5 * float(offsets.max() + offsets.min()) if len(offsets) else 0.0


def surface(points: Floats, least: int = MIN_CORRESPONDENCES) -> Surface | None:
    """Return points on smooth surfaces, of points (n, 2) ordered by bearing; None if they are fewer than `least`.

    Of more than MAX_REFERENCE_POINTS, every second, third, ... is returned.
    """
    before, after = np.roll(points, NORMAL_SPAN, axis=0), np.roll(points, -NORMAL_SPAN, axis=0)
    chord = after - before
    length, distance = np.hypot(*chord.T), np.hypot(*points.T)
    normals = np.column_stack([-chord[:, 1], chord[:, 0]]) / np.maximum(length, 1e-9)[:, None]
    sagitta = np.abs(((points - before) * normals).sum(axis=1))
    smooth = (length < SCALE + MAX_RANGE_STEP * distance) & (sagitta < SCALE)
    smooth[:NORMAL_SPAN] = smooth[-NORMAL_SPAN:] = False
    if np.count_nonzero(smooth) < least:
        return None
    rows = np.flatnonzero(smooth)
    rows = rows[:: -(-len(rows) // MAX_REFERENCE_POINTS)]
    order = np.argsort(points[rows, 0])
    return Surface(points[rows[order]], normals[rows[order]], order)


def find_rotation(scan: Scan, reference: Scan) -> float:
    """Return the heading of a scan in the frame of a reference at the same place, radians, to BIN."""
    ranges, of_reference = _range_profile(scan), _range_profile(reference)
    return BIN * float(np.argmin(_mean_differences(ranges, of_reference)) - MAX_ROTATION_STEPS)


@compiled
def _mean_differences(ranges, of_reference):  # type: ignore[no-untyped-def]
    """Return the mean differences (2 MAX_ROTATION_STEPS + 1,) of two range profiles (b,), one turned bin by bin.

    A difference counts as MAX_RANGE_STEP at most, and not at all where one of the scans has no return. It is infinite
    if there is no direction in which both have one.
    """
    bins, means = len(ranges), np.empty(2 * MAX_ROTATION_STEPS + 1)
    for k in range(len(means)):
        total, known = 0.0, 0
        for b in range(bins):
            at = b + MAX_ROTATION_STEPS - k
            at += bins if at < 0 else (-bins if at >= bins else 0)  # takes less time than a remainder
            difference = abs(ranges[at] - of_reference[b])
            if not math.isnan(difference):
                total += min(difference, MAX_RANGE_STEP)
                known += 1
        means[k] = total / known if known > 0 else np.inf
    return means


def _range_profile(scan: Scan) -> Floats:
    """Return the range in each direction bin around the lidar, metres; NaN where there is no return."""
    bins = round(2 * np.pi / BIN)
    profile = np.full(bins, np.nan)
    valid = np.isfinite(scan.ranges)
    index = ((se2.wrap(scan.angles[valid]) + np.pi) / (2 * np.pi) * bins).astype(np.int64) % bins
    profile[index] = scan.ranges[valid]
    for _ in range(2):  # beams may be farther apart than the bins
        profile = np.where(np.isnan(profile), np.roll(profile, 1), profile)
    return profile


def match(points: Floats, reference: Surface, guess: se2.Pose) -> Match | None:
    """Match points (n, 2) to a reference, starting from the pose `guess`; None if they have too little in common."""
    points = np.ascontiguousarray(points[:: max(1, -(-len(points) // MAX_POINTS))])
    start = np.array(guess, dtype=np.float64)
    pose, variance, cost = _match(points, reference.points, reference.normals, reference.order, start)
    return None if math.isinf(cost) else Match(pose, math.sqrt(variance), cost)


@compiled
def _match(points, reference, normals, order, pose):  # type: ignore[no-untyped-def]
    """Return the pose, the variance of its heading and the cost of `match`; the cost is infinite if there is no match.

    For the arguments see `_normal_equations`.
    """
    reach = FIRST_REACH
    for _ in range(MAX_ITERATIONS):
        equations = _normal_equations(points, reference, normals, order, pose, reach)
        information, gradient, found, weight, squares, loss = equations
        if found < MIN_CORRESPONDENCES:
            return pose, 0.0, np.inf
        for i in range(3):
            information[i, i] += REGULARISATION
        dx, dy, turn = solution(information, gradient)
        pose = np.array([pose[0] - dx, pose[1] - dy, pose[2] - turn])
        if reach == LAST_REACH and max(abs(dx), abs(dy), abs(turn)) < CONVERGED:
            break
        reach = max(LAST_REACH, REACH_FACTOR * reach)
    variance = squares / max(1.0, weight - 3.0) * inverse(information)[2, 2]
    unmatched = math.log1p((LAST_REACH / SCALE) ** 2) * (len(points) - found)
    return pose, variance, (loss + unmatched) / len(points)


def surface_loss(points: Floats, reference: Surface, reach: float) -> tuple[float, int]:
    """Return the negative log-likelihood of the points (n, 2) within `reach` metres of a surface, and their number."""
    equations = _normal_equations(points, reference.points, reference.normals, reference.order, np.zeros(3), reach)
    return equations[5], equations[2]


@compiled
def _normal_equations(points, reference, normals, order, pose, reach):  # type: ignore[no-untyped-def]
    """Return the information (3, 3) and the gradient (3,) of a pose by points (n, 2), and sums over those in reach.

    These are their number, and the sums of their weights, of their weighted squared errors and of their log-likelihoods
    log(1 + e^2 / s^2). A point is in reach if its nearest reference point is nearer than `reach` metres, the first one
    in their `order` (m,) of several. The reference points (m, 2) are sorted by x, so that only those up to `reach` to
    either side are compared.
    """
    information, gradient = np.zeros((3, 3)), np.zeros(3)
    found, weights, squares, loss, jacobian = 0, 0.0, 0.0, 0.0, np.empty(3)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for k in range(len(points)):
        lever_x, lever_y = c * points[k, 0] - s * points[k, 1], s * points[k, 0] + c * points[k, 1]
        x, y = pose[0] + lever_x, pose[1] + lever_y
        nearest, row = reach**2, -1
        for j in range(_first_in_reach(reference, x, reach), len(reference)):
            if reference[j, 0] - x >= reach:
                break
            squared = (x - reference[j, 0]) ** 2 + (y - reference[j, 1]) ** 2
            if squared < nearest or (squared == nearest and row >= 0 and order[j] < order[row]):
                nearest, row = squared, j
        if row < 0:
            continue
        jacobian[0], jacobian[1] = normals[row, 0], normals[row, 1]
        jacobian[2] = jacobian[1] * lever_x - jacobian[0] * lever_y
        error = (x - reference[row, 0]) * jacobian[0] + (y - reference[row, 1]) * jacobian[1]
        weight = 1.0 / (1.0 + (error / SCALE) ** 2)
        for i in range(3):
            gradient[i] += jacobian[i] * weight * error
            for j in range(3):
                information[i, j] += jacobian[i] * weight * jacobian[j]
        found, weights, squares = found + 1, weights + weight, squares + weight * error**2
        loss += math.log1p((error / SCALE) ** 2)
    return information, gradient, found, weights, squares, loss


@inlined
def _first_in_reach(points, x, reach):  # type: ignore[no-untyped-def]
    """Return the first row of points (m, 2), sorted by x, that is not `reach` or more before `x`, metres."""
    low, high = 0, len(points)
    while low < high:
        middle = (low + high) // 2
        if x - points[middle, 0] >= reach:
            low = middle + 1
        else:
            high = middle
    return low


def warm_up() -> None:
    """Compile the functions of scan matching, or load them from the cache."""
    angles = np.arange(-np.pi, np.pi, BIN)
    ranges = 2.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))  # of a square around the lidar
    scan = Scan(0.0, ranges, angles, np.zeros(len(angles)), 0.0, np.inf)
    points = scan_points(scan)
    if (square := surface(points)) is not None:
        match(points, square, np.array([0.0, 0.0, find_rotation(scan, scan)]))
