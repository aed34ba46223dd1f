"""All checks of a finished run, worst findings first."""

from __future__ import annotations

from .displaced_scans import displaced_scans
from .drive import Drive
from .passes import contradicting_passes
from .step_checks import changed_views, misplaced_scans, wrong_odometry
from .steps import judge_steps
from .suspect import ODOMETRY, Suspect


def find_suspects(drive: Drive) -> list[Suspect]:
    """Return the places where path, scans and odometry of a drive contradict each other, worst first.

    Those that contradict the path come first: wrong odometry may have been corrected by the scans.
    """
    sampled = drive.sampled()
    if len(sampled) < 2:
        return []
    steps = judge_steps(sampled)
    misplaced = list(misplaced_scans(sampled, steps))
    changed = [
        suspect
        for suspect in changed_views(sampled)
        if not any(other.first <= suspect.stamp <= other.last for other in misplaced)
    ]
    # where the view changes abruptly, the path says nothing about odometry
    odometry = [
        suspect
        for suspect in (wrong_odometry(sampled, steps) if sampled.has_odometry else ())
        if not any(suspect.first <= other.stamp <= suspect.last for other in changed)
    ]
    found = [*misplaced, *changed, *odometry, *contradicting_passes(sampled), *displaced_scans(sampled)]
    return sorted(found, key=lambda suspect: (suspect.check == ODOMETRY, -suspect.weight, suspect.stamp))
