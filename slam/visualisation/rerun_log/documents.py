"""The text panels, as markdown."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
from scipy.special import chdtri

from ...events import Correction, KeyframeAdded, LoopDecided
from ...graph.factor_residuals import CORNER, ODOMETRY, SAME_WALL, WALL, Residuals
from .matches import Matches

MOVED = 0.05  # metres by which a keyframe moved that is counted
SUMMARY_PENDING = "The run has not ended, or it ended without a summary."

# The names of the colours in colours.py.
_LEGEND: tuple[tuple[str, str], ...] = (
    ("white", "wall of the map; dim: seen by fewer than 3 keyframes; outline in the close-up: 3 sigma"),
    ("yellow", "corner of the map; ellipse: 3 sigma"),
    ("light blue", "robot, its path and its keyframes, the darker the less certain (5 cm, 20 cm); ellipse: 3 sigma"),
    ("grey", "path by odometry alone, from the same start; factors that fit badly"),
    ("green", "true path, where known, from the same start"),
    ("lavender", "this keyframe's scan"),
    ("orange", "matched with the map: segment, corner, recent wall; thin line: to what"),
    ("pink", "new: not in the map before"),
    ("light green", "loop closed; dashed: held, waits for a second look; arrows: how a closure moved each keyframe"),
    ("rust", "refused by a gate: feature, loop; factors beyond 99.9 %; dashed: a loop taken back"),
    ("deep blue", "before: walls, path, constellation as they were before the last closure"),
)
_TIMELINES: tuple[tuple[str, str], ...] = (
    ("keyframe", "from keyframe to keyframe"),
    ("sensor_time", "the robot moves with every scan"),
    ("candidate", "from decision to decision on a place that looked known"),
    ("closure", "from one correction of the map to the next: loops closed and taken back"),
)


def legend() -> str:
    """What the colours and timelines mean."""
    colours = "\n".join(f"- **{name}** {meaning}" for name, meaning in _LEGEND)
    timelines = "\n".join(f"- **{name}** {meaning}" for name, meaning in _TIMELINES)
    return (
        f"{colours}\n\nTimelines, below at the left:\n\n{timelines}\n\n"
        "Seen from above: x to the right, y up, metres. Hover over anything for its label: `L12 n=7` is wall 12, seen "
        "by 7 keyframes; `x` is a keyframe, `C` a corner; `d²` is the squared Mahalanobis distance, and a match is "
        "refused above 13.8.\n\n"
        "The whole map is drawn anew every few keyframes and at closures, as it was estimated then; its covariances "
        "are those of when each landmark was last seen, at the end those of the final map."
    )


def loop_report(event: LoopDecided) -> str:
    """A decision on a loop: what was found, each test with its gate, and what closing it did."""
    x, y, heading = (float(value) for value in event.motion)
    lines = [
        f"**Loop {event.candidate}: keyframe {event.index} at {event.old}, {event.status}**",
        "",
        f"{event.reason}; the robot would move by ({x:.2f}, {y:.2f}) m and {math.degrees(heading):.1f}°",
        "",
        "| test | value | gate | |",
        "|---|---|---|---|",
    ]
    for test in event.tests:
        relation = "≥" if test.at_least else "≤"
        verdict = "" if test.passed else "**fails**"
        name = _TESTS.get(test.name, test.name)
        lines.append(f"| {name} | {test.value:.3g} | {relation} {test.gate:.3g} | {verdict} |")
    if event.correction is not None:
        lines += _corrected(event.correction, len(event.merged))
    return "\n".join(lines)


_TESTS = {
    "drift": "motion, as a share of the drift to be expected",
    "overlap_ratio": "share of recent wall that falls on old wall",
    "weakest": "the same of the walls that tell of one direction, where it is least",
    "length": "metres of it",
    "gain": "metres more than where the robot is believed to be",
    "walls": "walls that fall on old ones",
    "sigma": "metres, in the worst known direction",
    "runner-up": "what another place explains, relative to this",
    "likelier-rival": "the same of places that odometry speaks for rather",
    "contradicted": "share seen through old walls",
    "unexpected": "standard deviations from the estimate",
}


def _corrected(correction: Correction, merged: int) -> list[str]:
    shifts = correction.shifts()
    moved = int((shifts > MOVED).sum())
    chi2 = [correction.chi2_before, correction.chi2_strained, correction.chi2]
    steps = " → ".join("?" if math.isnan(value) else f"{value:.0f}" for value in chi2)
    return [
        "",
        "| correction | |",
        "|---|---|",
        f"| walls made one | {merged} |",
        f"| chi² before → strained → after | {steps} |",
        f"| largest, mean shift | {shifts.max(initial=0.0):.2f} m, {shifts.mean() if len(shifts) else 0.0:.2f} m |",
        f"| keyframes moved by more than {100 * MOVED:.0f} cm | {moved} of {len(shifts)} |",
    ]


def residual_report(residuals: Residuals, count: int) -> str:
    """How well the factors fit by kind, and the `count` worst by name."""
    lines = ["| factors | number | mean d² / numbers measured | beyond 99.9 % |", "|---|---|---|---|"]
    for kind in (ODOMETRY, WALL, CORNER, SAME_WALL):
        chosen = residuals.of(kind)
        if not chosen.any():
            continue
        freedom, squared = residuals.freedom[chosen], residuals.squared[chosen]
        beyond = np.mean(squared > chdtri(freedom, 0.001))
        lines.append(f"| {kind} | {len(squared)} | {squared.sum() / freedom.sum():.2f} | {beyond:.1%} |")
    lines += ["", "The mean is 1 where the noise is as it is modelled.", ""]
    lines += ["| worst | kind | d² | weight |", "|---|---|---|---|"]
    for place in residuals.worst(count).tolist():
        squared, weight = residuals.squared[place], residuals.weight[place]
        lines.append(f"| {residuals.name(place)} | {residuals.kind[place]} | {squared:.1f} | {weight:.2f} |")
    lines += ["", "The weight is what the kernel leaves of a factor that does not fit."]
    return "\n".join(lines)


def configuration(config: str, recording: str, versions: Mapping[str, str]) -> str:
    """What was run: the recording's name, the settings (TOML) and the versions of what took part."""
    parts = []
    if recording:
        parts.append(f"Recording: `{recording}`")
    if config.strip():
        parts.append(f"```toml\n{config.strip()}\n```")
    if versions:
        parts.append(_table(("package", "version"), versions))
    return "\n\n".join(parts) or "Nothing was said about the settings."


def summary(values: Mapping[str, object]) -> str:
    """The end of a run: its summary as a table."""
    return _table(("quantity", "value"), values)


def keyframe(event: KeyframeAdded, position_sigma: float, heading_sigma: float) -> str:
    """One keyframe: where it is, how sure that is, and what became of each feature. Sigmas in metres and radians."""
    x, y, heading = event.pose
    sigma = f"{1e3 * position_sigma:.0f} mm, {math.degrees(heading_sigma):.2f}°"
    if math.isnan(position_sigma):
        sigma = "unknown"
    lines = [
        f"**Keyframe {event.index}** at {x:.2f} m, {y:.2f} m, {math.degrees(heading):.1f}°; sigma {sigma}",
        "",
        "| seen | length | matched | d² |",
        "|---|---|---|---|",
    ]
    walls, corners = Matches.of_lines(event), Matches.of_corners(event)
    lengths = [f"{2 * half_length:.2f} m" for half_length in event.segments.half_length.tolist()]
    lines += [
        f"| segment | {length} | {name} | {distance} |"
        for length, name, distance in zip(lengths, walls.names(), walls.distances(), strict=True)
    ]
    lines += [
        f"| corner | | {name} | {distance} |"
        for name, distance in zip(corners.names(), corners.distances(), strict=True)
    ]
    return "\n".join(lines)


def _table(header: tuple[str, str], values: Mapping[str, object]) -> str:
    rows = "\n".join(f"| {name} | {text} |" for name, text in _flat(values))
    return f"| {header[0]} | {header[1]} |\n|---|---|\n{rows}"


def _flat(values: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Names and values as text; `{"a": {"b": 1}}` is `a.b`, `1`."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            text = f"{value:.4g}" if isinstance(value, float) else str(value)
            yield f"{prefix}{key}", text.replace("|", "\\|").replace("\n", " ")
