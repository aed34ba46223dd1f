"""Estimate the direction that a lidar points in on its robot, to find one that is mounted backwards or aside.

Over pairs of scans, the lidar's motion t from scan matching is compared with that of the base by odometry, b
and its turn a. With the mount's position m and heading h,

    R(h) t = b + (R(a) - I) m,

which is linear in m, cos h and sin h; the common scale of the latter two is that of odometry's distances. The standard
deviation is that of the jackknife over the pairs.
"""

from __future__ import annotations

import numpy as np

from .. import se2
from ..immutable import immutable
from ..messages import Floats
from .delay import MAX_SCALE
from .motion_pairs import covered_pairs, jackknife_sigma, leave_one_out
from .student import ERROR_PROBABILITY, MIN_VALUES, upper_limit
from .turns import MAX_SCAN_PERIOD, Run, Turns

# Radians by which the heading must differ from the stated one: smaller errors are estimated while driving.
# Origin: chosen, 20 degrees; a mount that was measured by eye is better.
MIN_DIFFERENCE = 0.35


@immutable
class MountHeading:
    """Heading of a lidar on its robot as found from a drive, radians in [-pi, pi).

    stated   mount (3,) that the recording's scans state; None if they state none
    found    from the drive
    sigma    standard deviation of `found`
    pairs    pairs of scans
    """

    stated: se2.Pose | None
    found: float
    sigma: float
    pairs: int

    def contradicts(self, heading: float) -> bool:
        """Return true if the lidar certainly points more than MIN_DIFFERENCE away from a heading."""
        difference = abs(float(se2.wrap(self.found - heading)))
        return difference - MIN_DIFFERENCE > self.sigma * upper_limit(ERROR_PROBABILITY, self.pairs - 1)


def estimate_mount_heading(turns: Turns) -> MountHeading | None:
    """Return the heading over the turns of a drive; None if the data do not determine it."""
    equations = [equation for run in turns.runs for equation in _equations(run, turns)]
    if len(equations) < MIN_VALUES:
        return None
    normal = np.array([rows.T @ rows for rows, _ in equations])
    right = np.array([rows.T @ values for rows, values in equations])
    try:
        all_pairs, without_one = leave_one_out(normal, right)
    except np.linalg.LinAlgError:  # nothing moved
        return None
    found = float(np.arctan2(all_pairs[3], all_pairs[2]))
    sigma = jackknife_sigma(se2.wrap(np.arctan2(without_one[:, 3], without_one[:, 2]) - found))
    if not 1.0 / MAX_SCALE < float(np.hypot(all_pairs[2], all_pairs[3])) < MAX_SCALE or not np.isfinite(sigma):
        return None
    return MountHeading(turns.runs[0].scans[0].mount, found, sigma, len(equations))


def mount_equations(driven: Floats, observed: Floats) -> Floats:
    """Return the rows (2 n, 4) of the equations of the module for n motions, by m, cos h and sin h.

    driven    (n, 3) motions of the base; their n distances ahead and then their n distances to the left are the right
              sides
    observed  (n, 3) the same motions of the lidar
    """
    c, s = np.cos(driven[:, 2]) - 1.0, np.sin(driven[:, 2])
    x, y = observed[:, 0], observed[:, 1]
    return np.vstack([np.column_stack([-c, s, x, -y]), np.column_stack([-s, -c, y, x])])


def _equations(run: Run, turns: Turns) -> list[tuple[Floats, Floats]]:
    """Return the rows (2, 4) and right sides (2,) of the pairs of a run, for m, cos h and sin h."""
    equations = []
    for first, second in covered_pairs(run, turns.odometry[:, 0], MAX_SCAN_PERIOD):
        base = turns.path_at(run.stamps[[first, second]])
        driven, observed = se2.between(base[0], base[1]), se2.between(run.poses[first], run.poses[second])
        equations.append((mount_equations(driven[None], observed[None]), driven[:2]))
    return equations
