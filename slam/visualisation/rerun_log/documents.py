"""Compose the text panels of the review log as markdown."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from ...events import Correction, KeyframeAdded, LoopDecided
from ...formatting import percent
from ...geometry.chi_square import chi_square_tail
from ...graph.residuals import MEASUREMENTS, Residuals
from .feature_matches import FeatureMatches

MIN_SHIFT = 0.05  # metres; keyframes that a correction moved farther are counted
SUMMARY_PENDING = "The run has not ended, or it ended without a summary."

# Names and meanings of the colours in colours.py.
_LEGEND: tuple[tuple[str, str], ...] = (
    ("white", "wall of the map; dim: observed by fewer than 3 keyframes; outline in the close-up: 3 sigma"),
    ("yellow", "corner of the map; ellipse: 3 sigma, left out if it is longer than 0.75 m"),
    ("light blue", "robot, path and keyframes, darker for less certain ones (5 cm, 20 cm); ellipse: 3 sigma"),
    ("grey", "path from odometry alone, from the same start; rejected loop; feature outside the gate, not used"),
    ("green", "true path if known, from the same start"),
    ("lavender", "scan of this keyframe; dim: of earlier ones"),
    ("orange", "matched with the map: segment, corner, recent wall; thin line: to its match; relocalised robot"),
    ("pink", "new: not in the map before"),
    ("light green", "accepted loop; arrows: shift of each keyframe"),
    ("rust", "contradictions: suspect (disc), factor beyond 99.9 %, retracted loop (dashed)"),
    ("dim areas", "of the final map: free space; grey dots in it are occupied"),
    ("deep blue", "before the last correction: walls and path; recent points before the loop's motion"),
)
_TIMELINES: tuple[tuple[str, str], ...] = (
    ("keyframe", "from keyframe to keyframe"),
    ("sensor_time", "the robot moves with every scan"),
    ("candidate", "from one loop decision to the next"),
    ("closure", "from one correction of the map to the next: accepted and retracted loops; plots have one value each"),
)


def legend() -> str:
    """Return the meaning of the colours and timelines."""
    colours = "\n".join(f"- **{name}** {meaning}" for name, meaning in _LEGEND)
    timelines = "\n".join(f"- **{name}** {meaning}" for name, meaning in _TIMELINES)
    return (
        f"{colours}\n\nTimelines, selected at the bottom left:\n\n{timelines}\n\n"
        "View from above: x to the right, y up, metres. Hover over an object for its label: `L12 n=7` is wall 12, "
        "observed by 7 keyframes; `x` is a keyframe, `C` a corner; `d²` is the squared Mahalanobis distance, and "
        "matches above 13.8 are rejected.\n\n"
        "View of the confidence: bands behind the walls state how well the final map knows them: to 2 cm (light blue), "
        "5 cm (green), 10 cm (yellow), 20 cm (orange), or worse (rust); discs are weak places, and dashed lines drives "
        "that would improve them.\n\n"
        "Table of loop decisions: code A accepted, R rejected with the check that fails, X retracted; looks that "
        "support it; margin of the worst check, 1 if all are met; overlap, the share of the points that fit the old "
        "place; rival, the share of support for the strongest other place; shift of the robot in metres.\n\n"
        "The whole map is drawn every few keyframes and at corrections, as estimated then. Its covariances are those "
        "of the last observation of each landmark, at the end those of the final map."
    )


def loop_report(event: LoopDecided) -> str:
    """Return a report of a loop decision: the hypothesis, each test with its gate, and the correction."""
    x, y, heading = (float(value) for value in event.motion)
    lines = [
        f"**Loop {event.candidate}: keyframe {event.index} at the place of keyframe {event.old}, {event.status}**",
        "",
        f"{event.reason}; motion of the robot ({x:.2f}, {y:.2f}) m, {math.degrees(heading):.1f}°",
        "",
    ]
    # A list, not a table: the panel may be narrow, and the viewer breaks the lines of lists only.
    for check in event.checks:
        limit = f"at {'least' if check.at_least else 'most'} {check.gate:.3g}"
        verdict = "" if check.passed else ": **fails**"
        lines.append(f"- {_CHECKS.get(check.name, check.name)}: **{check.value:.3g}** ({limit}){verdict}")
    if event.correction is not None:
        lines += _correction_lines(event.correction, len(event.merged))
    return "\n".join(lines)


_CHECKS = {
    "support": "looks that support it",
    "span": "metres driven between the first and the last of them",
    "extent": "largest distance between positions that they show, metres",
    "contradicted": "looks that contradict it / looks that support it",
    "mahalanobis": "deviation from the estimate, sigmas",
    "rival": "looks that support another place / looks that support it",
    "last-look": "places that fit the last look as well",
    "gain": "logarithm of how much more likely all scans are in the corrected map",
    "retracted": "equal closures that were retracted",
}


def _correction_lines(correction: Correction, merged: int) -> list[str]:
    shifts = correction.shifts()
    moved = int((shifts > MIN_SHIFT).sum())
    chi2 = {
        "before": correction.chi2_before,
        "with the loop, not optimised": correction.chi2_strained,  # unknown if the loop was retracted
        "optimised": correction.chi2,
    }
    known = {name: value for name, value in chi2.items() if not math.isnan(value)}
    return [
        "",
        "Correction:",
        "",
        f"- merged walls: **{merged}**",
        f"- keyframes moved by more than {100 * MIN_SHIFT:.0f} cm: **{moved}** of {len(shifts)}",
        f"- shift of the keyframes: **{shifts.max(initial=0.0):.2f} m** at most, "
        f"{shifts.mean() if len(shifts) else 0.0:.2f} m on average",
        f"- chi² {' → '.join(known)}: **{' → '.join(f'{value:.0f}' for value in known.values())}**",
    ]


def residual_report(residuals: Residuals, count: int) -> str:
    """Return a table of the residuals by kind, and of the `count` worst factors."""
    lines = ["| kind | factors | mean d² / dof | beyond 99.9 % |", "|---|---|---|---|"]
    for kind in MEASUREMENTS:
        chosen = residuals.is_kind(kind)
        if not chosen.any():
            continue
        dof, squared = residuals.dof[chosen], residuals.squared[chosen]
        beyond = sum(int((chi_square_tail(n, squared[dof == n]) < 0.001).sum()) for n in np.unique(dof).tolist())
        share = percent(beyond / len(squared), 1)
        lines.append(f"| {kind} | {len(squared)} | {squared.sum() / dof.sum():.2f} | {share} |")
    expected = residuals.expected_wall_variance()
    lines += [
        "",
        f"The expected mean of walls is {expected:.2f} if the noise is as modelled: poses and walls are fitted to it. "
        "On recordings it is less, as errors that repeat from view to view move a wall as a whole. The covariances of "
        "the other kinds are widened, as they share points or errors with walls.",
        "",
    ]
    lines += ["| worst factors | kind | d² | weight |", "|---|---|---|---|"]
    for index in residuals.worst(count).tolist():
        squared, weight = residuals.squared[index], residuals.weight[index]
        lines.append(f"| {residuals.name(index)} | {residuals.kind[index]} | {squared:.1f} | {weight:.2f} |")
    lines += ["", "The weight is that of the robust kernel: 1 for a factor that fits, less for an outlier."]
    return "\n".join(lines)


def configuration(config: str, recording: str, versions: Mapping[str, str]) -> str:
    """Return the recording's name, the settings (TOML) and the package versions."""
    parts = []
    if recording:
        parts.append(f"Recording: `{recording}`")
    if config.strip():
        parts.append(f"```toml\n{config.strip()}\n```")
    if versions:
        parts.append(_table(("package", "version"), versions))
    return "\n\n".join(parts) or "No settings were recorded."


def summary(values: Mapping[str, object]) -> str:
    """Return the summary of a run as a table."""
    return _table(("quantity", "value"), values)


def keyframe(event: KeyframeAdded, position_sigma: float, heading_sigma: float) -> str:
    """Return a report of a keyframe: pose, sigmas (metres and radians) and the association of each feature."""
    x, y, heading = event.pose
    sigma = f"{1e3 * position_sigma:.0f} mm, {math.degrees(heading_sigma):.2f}°"
    if math.isnan(position_sigma):
        sigma = "unknown"
    lines = [
        f"**Keyframe {event.index}** at {x:.2f} m, {y:.2f} m, {math.degrees(heading):.1f}°; sigma {sigma}",
        "",
        "| feature | length | match | d² |",
        "|---|---|---|---|",
    ]
    walls, corners = FeatureMatches.of_segments(event), FeatureMatches.of_corners(event)
    lengths = [f"{2 * half_length:.2f} m" for half_length in event.segments.half_length.tolist()]
    lines += [
        f"| segment | {length} | {name} | {distance} |"
        for length, name, distance in zip(lengths, walls.names(), walls.distance_texts(), strict=True)
    ]
    lines += [
        f"| corner | | {name} | {distance} |"
        for name, distance in zip(corners.names(), corners.distance_texts(), strict=True)
    ]
    return "\n".join(lines)


def _table(header: tuple[str, str], values: Mapping[str, object]) -> str:
    rows = "\n".join(f"| {name} | {text} |" for name, text in _flat(values))
    return f"| {header[0]} | {header[1]} |\n|---|---|\n{rows}"


def _flat(values: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield names and values as text; `{"a": {"b": 1}}` becomes `a.b`, `1`."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            text = f"{value:.4g}" if isinstance(value, float) else str(value)
            yield f"{prefix}{key}", text.replace("|", "\\|").replace("\n", " ")
