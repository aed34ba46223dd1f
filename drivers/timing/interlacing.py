"""Find when the parts of interlaced scans were measured.

A lidar can measure at angles between those of the turn before, and send what it measured in each of these turns as a
scan of its own. Over a slow line such parts arrive, and are stamped, long after each other, though they were measured
in successive turns. So the heading of the lidar at each part is compared with the one that is interpolated at its stamp
between the parts at the angles of the first one. With e their difference, w the rate at which the lidar turns there,
and d the time by which the part is stamped late,

    minimise over d:    sum_k (e_k + w_k d)^2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..immutable import immutable
from ..messages import Floats, Scan
from .motion_pairs import jackknife_sigma, leave_one_out
from .student import ERROR_PROBABILITY, MIN_VALUES, upper_limit
from .turns import MAX_SCAN_PERIOD, Run, Turns

# Parts of a scan at most. Origin: definition, those of a lidar that measures in steps of a quarter of a degree, of
# which each turn shows every fourth.
MAX_PARTS = 4
# Radians up to which angles are the same. Origin: numerical, far above their resolution in a file, and far below the
# angle between two beams.
SAME_ANGLE = 1e-4


@immutable
class Interlacing:
    """Parts of interlaced scans that are stamped late against each other.

    angles    (p,) of the first beam of each part, radians
    lateness  (p,) seconds by which each part is stamped later after its measurement than the first one that is
    sigma     largest standard deviation of a difference between two of these, seconds
    """

    angles: Floats
    lateness: Floats
    sigma: float

    @property
    def earlier(self) -> float:
        """Seconds by which the stamps of scans become earlier, at most."""
        return float(self.lateness.max())

    def of(self, scan: Scan) -> Scan:
        """Return a scan with the stamp that it has if no part is stamped later than another one."""
        if not len(scan.angles):
            return scan
        late = float(self.lateness[np.abs(self.angles - scan.angles[0]) < SAME_ANGLE].sum())
        return replace(scan, stamp=scan.stamp - late) if late else scan

    def __str__(self) -> str:
        """Return which parts are late, as the beginning of a line of text."""
        late = [
            f"those from {np.degrees(angle):z.1f} degrees on are stamped {seconds:.3f} ± {self.sigma:.3f} s late"
            for angle, seconds in zip(self.angles.tolist(), self.lateness.tolist(), strict=True)
            if seconds
        ]
        return f"interlaced scans: {', '.join(late)}"


def find_interlacing(turns: Turns) -> Interlacing | None:
    """Return the parts of the scans of a drive that are significantly late against each other; None if there are none.

    Scans that follow each other faster than they are collected, see `Turns`, are not compared: they arrive in time.
    """
    angles = _first_angles(turns.collected)
    if not 1 < len(angles) <= MAX_PARTS:
        return None
    found = [_lateness(turns.runs, angles[0], angle) for angle in angles[1:]]
    late = [0.0, *(0.0 if one is None else one[0] for one in found)]
    if not any(late):
        return None
    sigma = max(one[1] for one in found if one is not None)
    return Interlacing(angles, np.array(late) - min(late), sigma)


def _first_angles(scans: Sequence[Scan]) -> Floats:
    """Return the angles of the first beams of the scans; none if they differ by the angle between two beams or more."""
    first = np.sort([float(scan.angles[0]) for scan in scans if len(scan.angles) > 1])
    if not len(first):
        return first
    step = float(np.median([float(np.diff(scan.angles[:2])[0]) for scan in scans if len(scan.angles) > 1]))
    return first[np.diff(first, prepend=-np.inf) > SAME_ANGLE] if np.ptp(first) < step else first[:0]


def _lateness(runs: Sequence[Run], reference: float, angle: float) -> tuple[float, float] | None:
    """Return the lateness of the part from `angle` on against that from `reference` on, and its standard deviation.

    Both are in seconds. None if the runs do not determine it, or if it is not significant.
    """
    compared = np.concatenate([np.zeros((0, 2)), *(_compare(run, reference, angle) for run in runs)])
    if len(compared) < MIN_VALUES:
        return None
    rates, errors = compared.T
    try:
        late, without = leave_one_out((rates**2)[:, None, None], (-rates * errors)[:, None])
    except np.linalg.LinAlgError:
        return None
    seconds, sigma = float(late[0]), jackknife_sigma(without[:, 0] - late[0])
    significant = abs(seconds) > sigma * upper_limit(ERROR_PROBABILITY / 2, len(compared) - 1)
    return (seconds, sigma) if significant else None


def _compare(run: Run, reference: float, angle: float) -> Floats:
    """Return the rates and the heading errors (n, 2) of the parts from `angle` on against those from `reference` on."""
    first = np.array([scan.angles[0] if len(scan.angles) else np.nan for scan in run.scans])
    known = np.flatnonzero(np.abs(first - reference) < SAME_ANGLE)
    if len(known) < 2:
        return np.zeros((0, 2))
    part = np.flatnonzero(np.abs(first - angle) < SAME_ANGLE)
    after = np.searchsorted(known, part)
    between = (after > 0) & (after < len(known))
    part, before, after = part[between], known[after[between] - 1], known[after[between]]
    headings, duration = run.poses[:, 2], run.stamps[after] - run.stamps[before]
    rates = (headings[after] - headings[before]) / duration
    errors = headings[part] - headings[before] - rates * (run.stamps[part] - run.stamps[before])
    return np.column_stack([rates, errors])[duration < MAX_SCAN_PERIOD]
