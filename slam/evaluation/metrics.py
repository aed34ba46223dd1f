"""Score trajectories against relations or against a reference trajectory.

All functions take and return plain numbers; plots are in `slam.visualisation.plots`, printing is in the command line.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.immutable import immutable

from ..errors import MapError
from ..geometry.segments import Floats
from ..io.tum import Trajectory, distance_along, read_table

Indices = NDArray[np.intp]

MAX_TIME_DIFFERENCE = 0.01
"""Seconds between the stamps of two poses that are compared; as in evo."""
MIN_ALIGNED_PAIRS = 2
"""Pairs of poses required for an alignment."""
MIN_UNRELATED_TURN = 0.1
"""Radians; RMS error of turns below which motions are taken to be of one drive: on straight drives, the turns of both
are noise. Origin: chosen, several times the error that odometry alone makes in a metre; not measured."""
MIN_EXPLAINED_TURNS = 0.5
"""Least share of the mean squared turn that a trajectory of the same drive explains. Origin: chosen, poor trajectories
explain nearly all of it, those of other drives nothing; not measured."""


@immutable
class MotionErrors:
    """Errors of n motions: `translation` (n,) metres, `rotation` (n,) radians, both absolute values."""

    translation: Floats
    rotation: Floats

    def __len__(self) -> int:
        return len(self.translation)


def motion_errors(estimated: Floats, true: Floats) -> MotionErrors:
    """Return the errors of motions (n, 3): norm of the translation error, absolute value of the heading error."""
    difference = estimated - true
    return MotionErrors(np.hypot(difference[:, 0], difference[:, 1]), np.abs(se2.wrap(difference[:, 2])))


def are_unrelated(errors: MotionErrors, true: Floats) -> bool:
    """Return True if a trajectory explains less than half of the turns of the true motions (n, 3), as of another drive.

    The share that it explains is 1 - (mean squared error) / (mean squared turn): zero for a straight path, and negative
    on average if the turns of both are independent.
    """
    if not len(errors):
        return False
    unexplained = math.sqrt(1.0 - MIN_EXPLAINED_TURNS) * _rms(se2.wrap(true[:, 2]))
    return _rms(errors.rotation) > max(unexplained, MIN_UNRELATED_TURN)


@immutable
class Relations:
    """True motions: `motion` (n, 3) is the pose at time `second` (n,) relative to the pose at time `first` (n,)."""

    first: Floats
    second: Floats
    motion: Floats

    def __len__(self) -> int:
        return len(self.first)


def read_relations(path: Path | str) -> Relations:
    """Read relations of the SLAM benchmark, one `t1 t2 x y z roll pitch yaw` per line.

    Raises MapError with file and line.
    """
    values = read_table(path, 8, "t1 t2 x y z roll pitch yaw").values
    return Relations(values[:, 0], values[:, 1], values[:, [2, 3, 7]])


@immutable
class RelationsScore:
    """Errors of the relations within the time of a trajectory.

    errors        in the order of the relations
    first         (n,) first stamps of the relations, seconds
    missing       number of relations outside the trajectory's time
    interpolated  share of relations with an interpolated pose
    unrelated     true if the trajectory is probably of another drive, see `are_unrelated`
    """

    errors: MotionErrors
    first: Floats
    missing: int
    interpolated: float
    unrelated: bool

    def figures(self) -> dict[str, float]:
        """Return the benchmark's figures in metres and degrees, rounded to meaningful digits."""
        translation, rotation = self.errors.translation, np.degrees(self.errors.rotation)
        return {
            "relations": len(self.errors),
            "missing": self.missing,
            "interpolated": round(self.interpolated, 4),
            "trans_mean": round(float(translation.mean()), 5),
            "trans_std": round(float(translation.std()), 5),
            "trans_median": round(float(np.median(translation)), 5),
            "trans_max": round(float(translation.max()), 4),
            "trans_sq_mean": round(float(np.square(translation).mean()), 6),
            "rot_mean": round(float(rotation.mean()), 4),
            "rot_std": round(float(rotation.std()), 4),
            "rot_max": round(float(rotation.max()), 3),
        }


def score_relations(trajectory: Trajectory, relations: Relations) -> RelationsScore:
    """Score a trajectory's motions against true ones (Kuemmerle et al., Autonomous Robots 27, 2009, eq. 4).

    Needs no alignment and is not dominated by one early error, unlike a comparison of absolute poses.
    Raises MapError if no relation lies within the trajectory's time.
    """
    start, end = trajectory.at(relations.first), trajectory.at(relations.second)
    covered = start.covered & end.covered
    if not covered.any():
        raise MapError("no relation lies within the trajectory's time: are both of the same recording?")
    estimated = se2.between(start.poses[covered], end.poses[covered])
    exact = (start.exact & end.exact)[covered]
    true = relations.motion[covered]
    errors = motion_errors(estimated, true)
    return RelationsScore(
        errors,
        relations.first[covered],
        int(np.sum(~covered)),
        float(1 - exact.mean()),
        are_unrelated(errors, true),
    )


@immutable
class ReferenceScore:
    """Errors of a trajectory against a reference at their n common times.

    stamps     (n,) of the reference, seconds
    reference  (n, 3) poses of the reference
    aligned    (n, 3) poses of the trajectory after rigid alignment with the reference
    alignment  [x, y, heading] of the alignment: aligned = compose(alignment, pose)
    absolute   errors of the aligned poses
    relative   errors of the motions over `step` metres of the reference's path, from every pose; may be empty
    unrelated  true if the trajectory is probably of another drive, see `are_unrelated`
    """

    stamps: Floats
    reference: Floats
    aligned: Floats
    alignment: se2.Pose
    absolute: MotionErrors
    relative: MotionErrors
    step: float
    unrelated: bool

    def figures(self) -> dict[str, float]:
        """Return absolute trajectory error (ate) and relative pose error (rpe) in metres and degrees, mostly as RMS."""
        figures = {
            "poses": float(len(self.stamps)),
            "ate_rmse": _rms(self.absolute.translation),
            "ate_mean": float(self.absolute.translation.mean()),
            "ate_median": float(np.median(self.absolute.translation)),
            "ate_max": float(self.absolute.translation.max()),
            "heading_rmse": math.degrees(_rms(self.absolute.rotation)),
        }
        if len(self.relative):
            figures["rpe_step"] = self.step
            figures["rpe_trans_rmse"] = _rms(self.relative.translation)
            figures["rpe_rot_rmse"] = math.degrees(_rms(self.relative.rotation))
        return {name: round(value, 6) for name, value in figures.items()} | {"poses": len(self.stamps)}


def score_reference(trajectory: Trajectory, reference: Trajectory, step: float = 1.0) -> ReferenceScore:
    """Return the absolute error after least-squares SE(2) alignment, and the relative error over `step` metres.

    Each pose of the sparser trajectory is paired with the nearest in time of the other, at most MAX_TIME_DIFFERENCE
    apart. Raises MapError if fewer than two poses can be paired.
    """
    own, other = pair_by_time(trajectory, reference)
    if len(own) < MIN_ALIGNED_PAIRS:
        raise MapError(
            f"trajectory and reference share {len(own)} times (within {MAX_TIME_DIFFERENCE} s), two are needed"
        )
    poses, truth = trajectory.poses[own], reference.poses[other]
    alignment = align(poses[:, :2], truth[:, :2])
    aligned = se2.compose(alignment, poses)
    first, second = pairs_by_distance(truth[:, :2], step)
    true = se2.between(truth[first], truth[second])
    relative = motion_errors(se2.between(poses[first], poses[second]), true)
    return ReferenceScore(
        reference.stamps[other],
        truth,
        aligned,
        alignment,
        motion_errors(aligned, truth),
        relative,
        step,
        are_unrelated(relative, true),
    )


def score_true_path(
    path: Trajectory, truth: Trajectory, delay: float | None
) -> tuple[ReferenceScore, Trajectory] | tuple[None, None]:
    """Return the error of a path against the truth in its recording, and the true path in the map.

    None if they have no common time. `delay` is that of the lidar (seconds), whose stamps the path has: the truth has
    those of odometry, and is returned with those of the path.
    """
    truth = Trajectory(truth.stamps + (delay or 0.0), truth.poses)
    try:
        score = score_reference(path, truth)
    except MapError:
        return None, None
    return score, Trajectory(truth.stamps, se2.compose(se2.inverse(score.alignment), truth.poses))


def pair_by_time(
    first: Trajectory, second: Trajectory, tolerance: float = MAX_TIME_DIFFERENCE
) -> tuple[Indices, Indices]:
    """Return indices (m,), (m,) of paired poses: each of the sparser trajectory with the nearest of the other.

    Poses without a partner within `tolerance` seconds are left out.
    """
    if len(first) > len(second):
        partner, sparse = pair_by_time(second, first, tolerance)
        return sparse, partner
    nearest = second.nearest(first.stamps)
    together = np.flatnonzero(np.abs(second.stamps[nearest] - first.stamps) <= tolerance)
    return together, nearest[together]


def align(points: Floats, onto: Floats) -> se2.Pose:
    """Return the rigid motion [x, y, heading] from `points` (n, 2) to `onto` (n, 2) by least squares.

    Horn's closed form in the plane: the heading is the phase of the summed products of the centred points.
    """
    from_centre, onto_centre = points.mean(axis=0), onto.mean(axis=0)
    p, q = points - from_centre, onto - onto_centre
    heading = math.atan2(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]), np.sum(p * q))
    offset = onto_centre - se2.transform([0.0, 0.0, heading], from_centre)
    return np.array([offset[0], offset[1], heading])


def pairs_by_distance(positions: Floats, step: float) -> tuple[Indices, Indices]:
    """Return indices (m,), (m,) of poses at `positions` (n, 2), and of the first pose at least `step` metres later."""
    travelled = distance_along(positions)
    second = np.searchsorted(travelled, travelled + step)
    first = np.flatnonzero(second < len(positions))
    return first, second[first]


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
