"""How good a trajectory and its covariances are: against relations, against a reference, against their own claims.

Everything is plain numbers in and out; drawing is in `slam.visualisation.plots`, printing in the command line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..errors import MapError
from ..io.tum import Trajectory, distance_along, read_table

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

SAME_TIME = 0.01
"""Seconds between two stamps that are still taken for the same time when two trajectories are compared; as in evo."""
SHORTEST_ALIGNED = 2
"""Pairs of poses that an alignment needs."""


@dataclass(frozen=True, slots=True, eq=False)
class MotionErrors:
    """n motions compared with the true ones: `translation` (n,) metres, `rotation` (n,) radians, both absolute."""

    translation: Floats
    rotation: Floats

    def __len__(self) -> int:
        return len(self.translation)


def motion_errors(estimated: Floats, true: Floats) -> MotionErrors:
    """Motions (n, 3) against true motions (n, 3): length of the translations' difference, size of the headings'."""
    difference = estimated - true
    return MotionErrors(np.hypot(difference[:, 0], difference[:, 1]), np.abs(se2.wrap(difference[:, 2])))


@dataclass(frozen=True, slots=True, eq=False)
class Relations:
    """n true motions: `motion` (n, 3) is the pose at time `second` (n,) seen from the pose at time `first` (n,)."""

    first: Floats
    second: Floats
    motion: Floats

    def __len__(self) -> int:
        return len(self.first)


def read_relations(path: Path) -> Relations:
    """The SLAM benchmark's relations, `t1 t2 x y z roll pitch yaw` a line. Raises MapError naming file and line."""
    values = read_table(path, 8, "t1 t2 x y z roll pitch yaw").values
    return Relations(values[:, 0], values[:, 1], values[:, [2, 3, 7]])


@dataclass(frozen=True, slots=True, eq=False)
class RelationsScore:
    """What `score_relations` found, over the relations that lie within the trajectory's time.

    errors        of those relations, in their order
    first         (n,) their first stamps, seconds
    missing       relations outside the trajectory's time
    interpolated  share of relations for which a pose had to be interpolated
    """

    errors: MotionErrors
    first: Floats
    missing: int
    interpolated: float

    def figures(self) -> dict[str, float]:
        """The score as the benchmark states it: metres and degrees, rounded to what is meaningful."""
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
    """Compare the trajectory's motions with true ones (Kuemmerle et al., Autonomous Robots 27, 2009, eq. 4).

    Needs no alignment and is not dominated by one early error, unlike a comparison of absolute poses.
    Raises MapError where no relation lies within the trajectory's time.
    """
    start, end = trajectory.at(relations.first), trajectory.at(relations.second)
    covered = start.covered & end.covered
    if not covered.any():
        raise MapError("no relation lies within the trajectory's time: are the two of the same recording?")
    estimated = se2.between(start.poses[covered], end.poses[covered])
    exact = (start.exact & end.exact)[covered]
    return RelationsScore(
        motion_errors(estimated, relations.motion[covered]),
        relations.first[covered],
        int(np.sum(~covered)),
        float(1 - exact.mean()),
    )


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceScore:
    """A trajectory compared with a reference over their n common times.

    stamps     (n,) seconds, the reference's
    reference  (n, 3) its poses
    aligned    (n, 3) the trajectory's poses, moved as a whole (rotation and translation) onto the reference
    alignment  [x, y, heading] that did so: aligned = compose(alignment, pose)
    absolute   distance and turn between the two after alignment
    relative   errors of the motions over `step` metres of the reference's path, from every pose on; may be empty
    """

    stamps: Floats
    reference: Floats
    aligned: Floats
    alignment: se2.Pose
    absolute: MotionErrors
    relative: MotionErrors
    step: float

    def figures(self) -> dict[str, float]:
        """Metres and degrees: absolute trajectory error (ate) and relative pose error (rpe) as root mean squares."""
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
    """Absolute error after the best SE(2) alignment, and relative error over `step` metres.

    The poses of the sparser trajectory are paired with the nearest in time of the other, at most SAME_TIME apart.
    Raises MapError where fewer than two poses have a partner.
    """
    mine, other = pair_by_time(trajectory, reference)
    if len(mine) < SHORTEST_ALIGNED:
        raise MapError(f"trajectory and reference share {len(mine)} times (within {SAME_TIME} s), two are needed")
    poses, truth = trajectory.poses[mine], reference.poses[other]
    alignment = align(poses[:, :2], truth[:, :2])
    aligned = se2.compose(alignment, poses)
    first, second = pairs_by_distance(truth[:, :2], step)
    relative = motion_errors(
        se2.between(poses[first], poses[second]),
        se2.between(truth[first], truth[second]),
    )
    return ReferenceScore(
        reference.stamps[other], truth, aligned, alignment, motion_errors(aligned, truth), relative, step
    )


def pair_by_time(first: Trajectory, second: Trajectory, tolerance: float = SAME_TIME) -> tuple[Indices, Indices]:
    """Indices (m,), (m,) of poses that belong together: each of the sparser trajectory with the nearest of the other.

    Poses without a partner within `tolerance` seconds are left out.
    """
    if len(first) > len(second):
        partner, sparse = pair_by_time(second, first, tolerance)
        return sparse, partner
    nearest = second.nearest(first.stamps)
    together = np.flatnonzero(np.abs(second.stamps[nearest] - first.stamps) <= tolerance)
    return together, nearest[together]


def align(points: Floats, onto: Floats) -> se2.Pose:
    """The rigid motion [x, y, heading] that brings `points` (n, 2) closest to `onto` (n, 2), least squares.

    Horn's closed form in the plane: the heading is the phase of the summed products of the centred points.
    """
    from_centre, onto_centre = points.mean(axis=0), onto.mean(axis=0)
    p, q = points - from_centre, onto - onto_centre
    heading = math.atan2(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]), np.sum(p * q))
    offset = onto_centre - se2.transform([0.0, 0.0, heading], from_centre)
    return np.array([offset[0], offset[1], heading])


def pairs_by_distance(positions: Floats, step: float) -> tuple[Indices, Indices]:
    """Indices (m,), (m,) of poses at `positions` (n, 2) and of the first at least `step` metres of path later."""
    travelled = distance_along(positions)
    second = np.searchsorted(travelled, travelled + step)
    first = np.flatnonzero(second < len(positions))
    return first, second[first]


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
