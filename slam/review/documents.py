"""The text panels, as markdown."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ..events import Integers, KeyframeAdded
from ..segments import Floats

SUMMARY_PENDING = "The run has not ended, or it ended without a summary."

# The names of the colours in colours.py.
_LEGEND: tuple[tuple[str, str], ...] = (
    ("white", "wall of the map; its band: 3 sigma"),
    ("dim white", "wall seen by fewer than 3 keyframes"),
    ("yellow", "corner of the map; ellipse: 3 sigma"),
    ("sky blue", "robot and its estimated path; ellipse: 3 sigma"),
    ("grey", "path by odometry alone, from the same start"),
    ("green", "true path, where known, from the same start"),
    ("lavender", "this keyframe's scan"),
    ("orange", "segment or corner matched with the map; thin line: to what"),
    ("pink", "segment that started a new wall"),
    ("brown", "segment or corner without a match so far"),
)


def legend() -> str:
    """What the colours and panels mean."""
    rows = "\n".join(f"| {name} | {meaning} |" for name, meaning in _LEGEND)
    return (
        f"| colour | meaning |\n|---|---|\n{rows}\n\n"
        "Seen from above: x to the right, y up, metres. Hover over anything for its label: `L12 n=7` is wall 12, "
        "seen by 7 keyframes; `d²` is the squared Mahalanobis distance at which a match was accepted.\n\n"
        "On the timeline `keyframe` the robot steps from keyframe to keyframe; on `sensor_time` it moves with every "
        "scan. The path and the whole map are drawn anew every few keyframes, as they were estimated then."
    )


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
    lines = [
        f"**Keyframe {event.index}** at {x:.2f} m, {y:.2f} m, {math.degrees(heading):.1f}°; "
        f"sigma {1e3 * position_sigma:.0f} mm, {math.degrees(heading_sigma):.2f}°",
        "",
        "| seen | length | matched | d² |",
        "|---|---|---|---|",
    ]
    new = set(event.new_lines.tolist())
    for i, half_length in enumerate(event.segments.half_length):
        matched = match_text("L", event.line_match, i, new)
        lines.append(f"| segment {i} | {2 * half_length:.2f} m | {matched} | {_gate(event.line_gate[i])} |")
    for i in range(len(event.corners)):
        matched = match_text("C", event.corner_match, i, set())
        lines.append(f"| corner {i} | | {matched} | {_gate(event.corner_gate[i])} |")
    return "\n".join(lines)


def match_text(prefix: str, match: Integers, i: int, new: set[int]) -> str:
    """`L12`, `L12 new`, or `none` for feature i."""
    identity = int(match[i])
    if identity < 0:
        return "none"
    return f"{prefix}{identity} new" if identity in new else f"{prefix}{identity}"


def match_label(prefix: str, match: Integers, gate: Floats, i: int, new: set[int]) -> str:
    """The label of feature i in the map: `L12 d²=3.1`."""
    text = match_text(prefix, match, i, new)
    return text if math.isnan(gate[i]) else f"{text} d²={gate[i]:.1f}"


def _gate(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.1f}"


def _table(header: tuple[str, str], values: Mapping[str, object]) -> str:
    rows = "\n".join(f"| {key} | {_value(value)} |" for key, value in values.items())
    return f"| {header[0]} | {header[1]} |\n|---|---|\n{rows}"


def _value(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {_value(v)}" for key, v in value.items())
    return str(value).replace("|", "\\|").replace("\n", " ")
