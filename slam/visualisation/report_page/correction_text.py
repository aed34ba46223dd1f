"""Manual corrections in words, for the terminal and the report page."""

from __future__ import annotations

import math
from typing import Any

from ...formatting import counted, length, percent
from ...geometry.chi_square import chi_square_quantile
from ...geometry.significance import GATE

LOOP_DOF, TIE_DOF = 3, 2
"""Degrees of freedom by which the map before contradicts a closed loop, or that two walls are one."""


def outcome_lines(outcome: dict[str, Any]) -> list[str]:
    """Return what became of a correction, an entry of `corrections` in summary.json, in words; may be empty."""
    if "pins" in outcome:
        fit = [f"chi-square of the pins used: {outcome['chi2']:.1f}, {outcome['dof']} degrees of freedom"]
        return [*(_pin_line(pin) for pin in outcome["pins"]), *(fit if outcome["dof"] else ())]
    if "shift" in outcome:
        moved = f"keyframe {outcome['keyframe']} moves by {length(outcome['shift'])}"
        if "fit" not in outcome:
            lines = [f"{moved}; it was at the place of keyframe {outcome['old']}"]
            if outcome.get("separated"):
                lines.append("the parts of the map that it joined are unconnected: odometry alone places the later one")
            return lines
        return [
            f"{moved} to the place of keyframe {outcome['old']}: {outcome['deviations']:.1f} standard deviations; "
            f"{percent(outcome['fit'])} of the points fit, {counted(outcome['merged'], 'wall')} merged",
            *_doubt(outcome["deviations"], LOOP_DOF, "two places that look alike fit as well"),
        ]
    if "offset" in outcome:
        turn = math.degrees(outcome["turn"])
        return [
            f"they were {length(abs(outcome['offset']))} and {abs(turn):.2f}° apart: "
            f"{outcome['deviations']:.1f} standard deviations",
            *_doubt(outcome["deviations"], TIE_DOF, "they may be two walls"),
        ]
    return []


def _doubt(deviations: float, dof: int, meaning: str) -> list[str]:
    """Return a line that says why a correction is doubtful, if the uncertainty of the map does not admit it."""
    most = math.sqrt(chi_square_quantile(GATE, dof))
    return [f"DOUBTFUL: the map admits at most {most:.1f} standard deviations; {meaning}"] if deviations > most else []


def _pin_line(pin: dict[str, Any]) -> str:
    if not pin["used"]:
        return (
            f"LEFT OUT {pin['name']}: {length(pin['before'])} from its place by the map and the other pins "
            f"(p = {pin['p_value']:.1g})"
        )
    checked = f"p = {pin['p_value']:.2g}" if pin["checked"] else "no other pin checks it"
    return f"{pin['name']}: {length(pin['before'])} off before, {length(pin['after'])} after ({checked})"
