"""Judge every step of the path by the scans and by odometry.

A step leads from one checked scan to the next. Two things speak for or against it: how well the scan fits the scans
just before it, and how far the step departs from odometry. Both are added as logarithms of a probability: the fit times
FIT_WEIGHT, and for odometry a Cauchy distribution, since wheels slip now and then. The scans before say nothing about a
long step, as over a hole in the scans: odometry alone judges it. Steps on which odometry was missing or known to fail
are not judged in this way, and steps over scans that were dropped not at all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drivers import se2

from ..geometry.segments import Floats
from ..geometry.surroundings import ROOM_SIZE
from ..localisation.odometry_comparison import GROSS_SHARE
from ..loop_closure.relative_uncertainty import MAX_SQUARED_DISTANCE
from ..odometry.history import wheel_travel
from .distance_rings import DistanceRings, compared_points
from .drive import Drive
from .pose_search import search_pose

# Scans that make the local field: about four metres of driving. Origin: chosen; not measured.
FIELD_SCANS = 12
# Logarithm of the likelihood ratio between a scan that fits everywhere and one that fits nowhere. Neighbouring beams
# hit the same surface, so they do not count one by one: about 15 surfaces, each some e^2.7 times as likely if it fits.
# Origin: chosen. On recordings whose paths are right the best alternative is mostly below 10, while 10 to 12.5 is
# reported; on GMapping's path of fr079 it is 16, for poses that differ by less than is reported.
FIT_WEIGHT = 40.0
# Probability of a false alarm in a whole drive whose errors are as modelled. Origin: chosen.
FALSE_ALARM_PROBABILITY = 0.01
# Exponent of the density (1 + d^2)^-2 of the Cauchy distribution in three dimensions. Origin: definition.
CAUCHY_EXPONENT = 2.0
# Standard deviations of odometry within which better poses are searched. Origin: chosen; errors beyond are unlikely.
SEARCH_SIGMAS = 4.0
# Least and greatest half width of the search: x, y (metres), heading (radians). Below the least, two poses hardly
# differ in their fit; beyond the greatest, odometry has little to say. Origin: chosen; not measured.
MIN_SEARCH = np.array([0.3, 0.3, math.radians(8.0)])
# Likewise. Origin: chosen; not measured.
MAX_SEARCH = np.array([0.8, 0.8, math.radians(25.0)])
# Metres of odometry between two scans above which the local field says nothing about a step.
# Origin: definition, as far as one sees into the next room.
MAX_STEP = ROOM_SIZE


@dataclass(slots=True, eq=False)
class Steps:
    """The n - 1 steps between n checked scans; arrays of unjudged steps are NaN or zero, as is the fit where
    odometry alone judges.

    threshold    gain above which a step is suspicious: ln of the number of steps per allowed false alarm
    error        (n - 1, 3) motion along the path relative to odometry's
    distance     (n - 1,) its squared Mahalanobis distance
    fit          (n - 1,) fit of the scan at its final pose
    gain         (n - 1,) logarithm of the probability of the alternative relative to that of the final pose
    fit_gain     (n - 1,) the part of `gain` that the fit contributes
    alternative  (n - 1, 3) best pose near odometry
    slip         (n - 1,) logarithm by which the scans prefer the final pose to any pose near odometry, if odometry is
                 grossly wrong, else zero
    """

    threshold: float
    error: Floats
    distance: Floats
    fit: Floats
    gain: Floats
    fit_gain: Floats
    alternative: Floats
    slip: Floats


def judge_steps(drive: Drive) -> Steps:
    """Judge all steps of a sampled drive."""
    count = len(drive) - 1
    rows = np.arange(count)
    error, distance = drive.departures(rows, rows + 1)
    steps = Steps(
        threshold=math.log(max(count, 1) / FALSE_ALARM_PROBABILITY),
        error=error,
        distance=distance,
        fit=np.full(count, np.nan),
        gain=np.zeros(count),
        fit_gain=np.zeros(count),
        alternative=drive.poses[1:].copy(),
        slip=np.zeros(count),
    )
    measured = se2.between(drive.odometry[:-1], drive.odometry[1:])
    continuous, short = np.isfinite(distance), wheel_travel(measured) <= MAX_STEP
    prior = _log_prior(_lasting(drive, distance))
    gross = _grossly_wrong(drive, measured, distance)
    field = DistanceRings()
    for k in range(count):
        field.add(drive.points[k], drive.poses[k])
        if k >= FIELD_SCANS:
            field.remove(drive.points[k - FIELD_SCANS], drive.poses[k - FIELD_SCANS])
        if continuous[k] and short[k]:
            if drive.measured[k + 1]:
                _judge(steps, k, drive, field, measured[k], float(prior[k]))
            if gross[k]:
                _judge_odometry(steps, k, drive, field, measured[k])
    alone = np.flatnonzero(continuous & ~short & drive.measured[1:])
    steps.gain[alone], steps.alternative[alone] = -prior[alone], se2.compose(drive.poses[alone], measured[alone])
    return steps


def _judge(steps: Steps, k: int, drive: Drive, field: DistanceRings, measured: se2.Pose, prior: float) -> None:
    """Compare the final pose of a step with others; `measured` is its motion by odometry, `prior` the logarithm."""
    points, before, after = compared_points(drive.points[k + 1]), drive.poses[k], drive.poses[k + 1]
    steps.fit[k] = fit = float(field.fits(points, after[None])[0])
    variances = drive.variances(measured)
    if FIT_WEIGHT * (1.0 - fit) - prior > steps.threshold:  # else no alternative can be that much better
        half_width = np.clip(SEARCH_SIGMAS * np.sqrt(variances), MIN_SEARCH, MAX_SEARCH)
        pose, best_fit, best_prior = _search(field, points, before, measured, variances, half_width)
        steps.fit_gain[k] = FIT_WEIGHT * (best_fit - fit)
        steps.gain[k] = steps.fit_gain[k] + best_prior - prior
        steps.alternative[k] = pose


def _judge_odometry(steps: Steps, k: int, drive: Drive, field: DistanceRings, measured: se2.Pose) -> None:
    """Fill in `slip` of a step with grossly wrong odometry, which measured the motion `measured`."""
    points, before, after = compared_points(drive.points[k + 1]), drive.poses[k], drive.poses[k + 1]
    variances = drive.variances(measured)
    best_fit = _search(field, points, before, measured, variances, SEARCH_SIGMAS * np.sqrt(variances))[1]
    steps.slip[k] = FIT_WEIGHT * (float(field.fits(points, after[None])[0]) - best_fit)


def _search(
    field: DistanceRings, points: Floats, before: se2.Pose, measured: se2.Pose, variances: Floats, half_width: Floats
) -> tuple[se2.Pose, float, float]:
    """Return the most probable pose around odometry's, its fit, and the logarithm that odometry contributes."""

    def priors(motions: Floats) -> Floats:
        return _log_prior((se2.between(measured, motions) ** 2 / variances).sum(axis=-1))

    def scores(motions: Floats) -> Floats:
        return FIT_WEIGHT * field.fits(points, se2.compose(before, motions)) + priors(motions)

    motion = search_pose(scores, measured, half_width)
    pose = se2.compose(before, motion)
    return pose, float(field.fits(points, pose[None])[0]), float(priors(motion))


def _log_prior(squared: Floats) -> Floats:
    """Return the logarithm of the Cauchy density relative to its maximum, by squared Mahalanobis distance."""
    return -CAUCHY_EXPONENT * np.log1p(squared)


def _lasting(drive: Drive, distance: Floats) -> Floats:
    """Return the squared distance (n - 1,) from odometry of each step, or that over two steps if this is less.

    A late odometry reading and a single blurred scan make two steps wrong, in opposite directions; the path is right.
    """
    lasting = distance.copy()
    rows = np.arange(len(drive) - 2)
    if len(rows):
        both = drive.departures(rows, rows + 2)[1]
        lasting[:-1] = np.minimum(lasting[:-1], both)
        lasting[1:] = np.minimum(lasting[1:], both)
    return lasting


def _grossly_wrong(drive: Drive, measured: Floats, distance: Floats) -> Floats:
    """Return (n - 1,) True for steps in which odometry is wrong by a large share of the motion."""
    moved = np.maximum(wheel_travel(measured), wheel_travel(se2.between(drive.poses[:-1], drive.poses[1:])))
    final = se2.between(drive.poses[:-1], drive.poses[1:])
    wrong = wheel_travel(se2.between(measured, final)) > GROSS_SHARE * moved
    return np.asarray(wrong & (distance > MAX_SQUARED_DISTANCE))
