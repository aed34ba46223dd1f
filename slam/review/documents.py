"""The text panels, as markdown."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from ..events import KeyframeAdded
from .matches import Matches

SUMMARY_PENDING = "The run has not ended, or it ended without a summary."

# The names of the colours in colours.py.
_LEGEND: tuple[tuple[str, str], ...] = (
    ("white", "wall of the map; outline in the close-up: 3 sigma"),
    ("dim white", "wall seen by fewer than 3 keyframes"),
    ("yellow", "corner of the map; ellipse: 3 sigma"),
    ("sky blue", "robot and its estimated path; ellipse: 3 sigma"),
    ("grey", "path by odometry alone, from the same start"),
    ("green", "true path, where known, from the same start"),
    ("bright green", "loop closed: the keyframe and one that saw the place before"),
    ("vermillion", "last place that looked known, held or refused; the log says why"),
    ("lavender", "this keyframe's scan"),
    ("orange", "segment or corner matched with the map; thin line: to what"),
    ("pink", "segment or corner new in the map"),
    ("brown", "segment or corner left out: ambiguous or unmatched"),
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
