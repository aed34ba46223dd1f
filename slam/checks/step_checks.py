"""Suspects among the steps: scans that were placed wrongly, and odometry that contradicts the scans."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from drivers import se2

from ..formatting import counted
from ..geometry.segments import Floats, Integers
from ..localisation.odometry_comparison import GROSS_SHARE
from ..odometry.history import wheel_travel
from .drive import Drive
from .row_groups import MAX_GAP, consecutive_groups
from .steps import FIT_WEIGHT, Steps
from .suspect import ODOMETRY, PLACEMENT, Suspect
from .view_changes import MIN_RATIO, view_changes

# Metres (RMS) by which the points of a scan differ between two poses that are not the same. Origin: tuned on the full
# Intel log, where 0.3 hid visible breaks of the walls; two cells of the local field.
MIN_DISPLACEMENT = 0.2
# Metres (RMS) by which odometry must misplace the points of a scan in the end. Origin: tuned on CSAIL and fr079: so
# late readings and slips of half a metre, of which they have many, are not reported.
MIN_SLIP = 1.0
# Metres of a motion from which on it has a direction, and radians from which on two directions are stated to differ.
# Origin: chosen for the text; not measured.
MIN_DIRECTED, MIN_DEVIATION = 0.1, math.radians(45.0)


def misplaced_scans(drive: Drive, steps: Steps) -> Iterator[Suspect]:
    """Yield the steps whose scan would better be elsewhere near odometry.

    Either the scan fits the scans before it better there, or the step departs from odometry although the scan fits
    about as well at odometry's motion.
    """
    for group in consecutive_groups(np.flatnonzero(_misplacements(drive, steps)), MAX_GAP):
        worst = int(group[np.argmax(steps.gain[group])])
        yield _suspect(drive, PLACEMENT, group, worst, steps.gain[worst] / steps.threshold, _text(drive, steps, worst))


def _misplacements(drive: Drive, steps: Steps) -> Floats:
    """Return (n - 1,) the metres (RMS) by which the scan of each step is misplaced, zero if it is not."""
    metres = np.zeros(len(steps.gain))
    for k in np.flatnonzero(steps.gain > steps.threshold).tolist():
        metres[k] = displacement(drive.points[k + 1], drive.poses[k + 1], steps.alternative[k])
    return np.where(metres > MIN_DISPLACEMENT, metres, 0.0)


def changed_views(drive: Drive) -> Iterator[Suspect]:
    """Yield the steps at which the view changes abruptly: the robot was carried unnoticed, or the step is wrong."""
    found, counts = view_changes(drive)
    shares = 100 * counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    for group in consecutive_groups(found, MAX_GAP):
        rows = np.searchsorted(found, group)
        worst = int(rows[np.argmin(shares[rows, 2])])
        seen_through, behind, agreeing = shares[worst]
        text = (
            f"the view changes abruptly: {seen_through:.0f} % of the scan's points are where the scan before saw "
            f"through, {behind:.0f} % behind what it saw; the robot was carried, or the scan was placed wrongly"
        )
        weight = (100 - agreeing) / (100 * MIN_RATIO / (1 + MIN_RATIO))
        yield _suspect(drive, PLACEMENT, group, int(found[worst]), weight, text)


def displacement(points: Floats, pose: se2.Pose, other: se2.Pose) -> float:
    """Return the metres (RMS) by which a scan's points (p, 2) move if it is placed at the `other` pose."""
    moved = se2.transform(pose, points) - se2.transform(other, points)
    return float(np.sqrt((moved**2).sum(axis=1).mean()))


def _text(drive: Drive, steps: Steps, k: int) -> str:
    better = steps.fit[k] + steps.fit_gain[k] / FIT_WEIGHT
    if steps.fit_gain[k] >= 0.5 * steps.gain[k]:
        away = as_text(se2.between(steps.alternative[k], drive.poses[k + 1]))
        fits = f"fit {better:.2f} there, {steps.fit[k]:.2f} where it was placed"
        return f"the scan fits the scans before it better {away} from where it was placed ({fits})"
    motion, pose, slip = "odometry", "odometry's pose", "wheels that slipped, "
    if not drive.has_odometry:
        motion, pose, slip = "the motion at constant velocity", "the predicted pose", ""
    departs = f"the path departs from {motion} by {as_text(steps.error[k])} ({math.sqrt(steps.distance[k]):.0f} sigma)"
    if math.isnan(steps.fit[k]):
        return f"{departs}, over a motion of which no scan shows anything: a wrong pose, {slip}or the robot was carried"
    fits = f"fit {better:.2f} at {pose}, {steps.fit[k]:.2f} where it was placed"
    return f"{departs}, which the scan does not require ({fits}): a wrong pose, or the robot was carried"


def wrong_odometry(drive: Drive, steps: Steps) -> Iterator[Suspect]:
    """Yield the intervals in which the scans show that odometry is wrong by a large share of the motion.

    A late reading is not such an error, nor is an uneven motion between two readings. So odometry must also be wrong
    from the scan before the interval to the one after, and from the readings before to those after.
    The path may be wrong there by as much as the scans in between are misplaced, so odometry must be wrong by more.
    Before the first reading and after the last one, odometry is missing, which the run says elsewhere.
    """
    misplaced = _misplacements(drive, steps)
    first, last = (drive.readings[0], drive.readings[-1]) if len(drive.readings) else (-np.inf, np.inf)
    wrong_steps = (steps.slip > 0.0) & (drive.stamps[1:] > first) & (drive.stamps[:-1] < last)
    for group in consecutive_groups(np.flatnonzero(wrong_steps), MAX_GAP):
        evidence = float(steps.slip[group].sum())
        before, after = _rows_around(drive, group)
        driven = se2.between(drive.poses[before], drive.poses[after])
        measured = se2.between(drive.odometry[before], drive.odometry[after])
        wrong = se2.between(measured, driven)
        lasting = wheel_travel(wrong) > GROSS_SHARE * max(wheel_travel(driven), wheel_travel(measured))
        by_odometry = se2.compose(drive.poses[before], measured)
        slip = displacement(drive.points[after], drive.poses[after], by_odometry) - misplaced[before:after].sum()
        if evidence > steps.threshold and lasting and slip > MIN_SLIP:
            worst = int(group[np.argmax(steps.slip[group])])
            text = (
                f"odometry contradicts the scans by {as_text(wrong)}: it measured a motion of {as_text(measured)}, the "
                f"scans show {as_text(driven)}{_direction(measured, driven)}; the wheels slipped or stood still, or "
                "the robot was carried"
            )
            yield _suspect(drive, ODOMETRY, group, worst, evidence / steps.threshold, text)


def _rows_around(drive: Drive, steps: Integers) -> tuple[int, int]:
    """Return the scan before a group of steps and the one after, or as far apart as the odometry readings around both.

    Odometry is compared within one segment only.
    """
    before, after = drive.between_readings(max(int(steps[0]) - 1, 0), min(int(steps[-1]) + 2, len(drive) - 1))
    begin = int(np.searchsorted(drive.segment, drive.segment[steps[0]]))
    end = int(np.searchsorted(drive.segment, drive.segment[steps[-1] + 1], side="right"))
    return max(before, begin), min(after, end - 1)


def _suspect(drive: Drive, check: str, steps: Integers, worst: int, weight: float, text: str) -> Suspect:
    """Return the suspect of a group of steps, named by the scans at their ends."""
    first, last = (float(drive.stamps[int(step) + 1]) for step in (steps[0], steps[-1]))
    stamp, position = float(drive.stamps[worst + 1]), drive.poses[worst + 1, :2]
    return Suspect(check, stamp, first, last, position, float(weight), text)


def as_text(motion: se2.Pose) -> str:
    """Return length and turn of a motion as text."""
    return f"{math.hypot(motion[0], motion[1]):.2f} m and {counted(round(abs(math.degrees(motion[2]))), 'degree')}"


def _direction(motion: se2.Pose, other: se2.Pose) -> str:
    """Return a remark on two motions, metres and radians, if their directions differ; else an empty text."""
    angle = abs(se2.wrap(math.atan2(other[1], other[0]) - math.atan2(motion[1], motion[0])))
    if min(math.hypot(motion[0], motion[1]), math.hypot(other[0], other[1])) < MIN_DIRECTED or angle < MIN_DEVIATION:
        return ""
    return f", in a direction that differs by {math.degrees(angle):.0f} degrees"
