"""Suspects among the steps: scans that were placed wrongly, and odometry that contradicts the scans."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from drivers import se2

from ..geometry.segments import Floats
from .drive import Drive, consecutive_groups
from .local_field import REACH
from .steps import FIT_WEIGHT, Steps
from .suspect import Suspect

# Steps without a finding that may lie between two findings of one interval. Origin: chosen, about a metre.
MAX_GAP = 3


def misplaced_scans(drive: Drive, steps: Steps) -> Iterator[Suspect]:
    """Yield the steps whose scan would better be elsewhere near odometry.

    Either the scan fits the scans before it better there, or the step departs from odometry although the scan fits
    about as well at odometry's motion.
    """
    apart = np.array([_displacement(drive, steps, k) for k in range(len(steps.gain))])
    found = np.flatnonzero((steps.gain > steps.threshold) & (apart > REACH))
    for group in consecutive_groups(found, MAX_GAP):
        worst = int(group[np.argmax(steps.gain[group])])
        yield _suspect(drive, "placement", group, worst, steps.gain[worst] / steps.threshold, _text(drive, steps, worst))


def _displacement(drive: Drive, steps: Steps, k: int) -> float:
    """Return the metres (RMS) by which a scan's points differ between its final pose and the alternative."""
    if steps.gain[k] <= steps.threshold:
        return 0.0
    points = drive.points[k + 1]
    moved = se2.transform(drive.poses[k + 1], points) - se2.transform(steps.alternative[k], points)
    return float(np.sqrt((moved**2).sum(axis=1).mean()))


def _text(drive: Drive, steps: Steps, k: int) -> str:
    better = steps.fit[k] + steps.fit_gain[k] / FIT_WEIGHT
    fits = f"fit {better:.2f} there, {steps.fit[k]:.2f} where it was placed"
    away = se2.between(steps.alternative[k], drive.poses[k + 1])
    if steps.fit_gain[k] >= 0.5 * steps.gain[k]:
        return f"the scan fits the scans before it better {_motion(away)} from where it was placed ({fits})"
    sigmas = math.sqrt(steps.distance[k])
    return (
        f"the path departs from odometry by {_motion(steps.error[k])} ({sigmas:.0f} sigma), although the scan does not "
        f"fit much better so ({fits})"
    )


def wrong_odometry(drive: Drive, steps: Steps) -> Iterator[Suspect]:
    """Yield the intervals in which the scans show that odometry is wrong by a large share of the motion."""
    for group in consecutive_groups(np.flatnonzero(steps.slip > 0.0), MAX_GAP):
        evidence = float(steps.slip[group].sum())
        before, after = int(group[0]), int(group[-1]) + 1
        driven = se2.between(drive.poses[before], drive.poses[after])
        measured = se2.between(drive.odometry[before], drive.odometry[after])
        lever = REACH / _typical_range(drive, after)
        wrong = se2.between(measured, driven)
        if evidence > steps.threshold and (math.hypot(*wrong[:2]) > REACH or abs(wrong[2]) > lever):
            worst = int(group[np.argmax(steps.slip[group])])
            text = (
                f"odometry contradicts the scans: it measured {_motion(measured)}, the scans show {_motion(driven)}; the "
                "wheels slipped or stood still, or the robot was carried"
            )
            yield _suspect(drive, "odometry", group, worst, evidence / steps.threshold, text)


def _typical_range(drive: Drive, row: int) -> float:
    return float(np.sqrt((drive.points[row] ** 2).sum(axis=1).mean()))


def _suspect(drive: Drive, check: str, steps: Floats, worst: int, weight: float, text: str) -> Suspect:
    """Return the suspect of a group of steps, named by the scans at their ends."""
    first, last = (float(drive.stamps[int(step) + 1]) for step in (steps[0], steps[-1]))
    stamp, position = float(drive.stamps[worst + 1]), drive.poses[worst + 1, :2]
    return Suspect(check, stamp, first, last, position, float(weight), text)


def _motion(motion: se2.Pose) -> str:
    """Return length and turn of a motion as text."""
    return f"{math.hypot(motion[0], motion[1]):.2f} m and {abs(math.degrees(motion[2])):.0f} degrees"
