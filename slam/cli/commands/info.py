"""`wclm info`: content of a recording and problems in its data."""

from __future__ import annotations

import math
import shlex
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import typer

from drivers.timestamps import MIN_EPOCH_STAMP

from ...formatting import counted
from ..console import printable
from ..options import OtherRecordingArgument

if TYPE_CHECKING:
    from drivers import RecordingInfo

    from ...io.recording_timing import RecordingTiming


MIN_INTENSITY, MAX_INTENSITY = 1e-9, 1e9
"""Limits of the largest intensity: others are no measurements, which have 16 bits at most, but memory that a driver did
not set.
"""


def info(
    recording: OtherRecordingArgument,
) -> None:
    """Describe a recording and report problems in its data: rates, gaps, stamps, beams, odometry.

    Example: [bold]wclm info intel.clf[/bold]
    """
    import drivers

    from ...io.recording_timing import RecordingTiming

    source = drivers.open(recording)
    timing = RecordingTiming.of(source)  # the messages that it has read are inspected
    typer.echo("\n".join(describe(drivers.inspect(source), timing)))


def describe(found: RecordingInfo, timing: RecordingTiming) -> list[str]:
    """Return the description as lines of text, without entries that the recording does not have."""
    rows = [("time", _time(found))]
    rows.append(("scans", _count(found.scans, found.scan_rate) + _source(found.report.scan_topic)))
    if found.beams and found.field_of_view:
        few, many = found.beams
        first, last = (math.degrees(angle) for angle in found.field_of_view)
        rows.append(("beams", f"{few if few == many else f'{few} to {many}'} from {first:.1f} to {last:.1f} degrees"))
    if found.ranges and found.range_limits:
        rows.append(
            (
                "ranges",
                f"{found.ranges[0]:.2f} to {found.ranges[1]:.2f} m; stated limits "
                f"{found.range_limits[0]:g} to {found.range_limits[1]:g} m",
            )
        )
    if found.invalid_share is not None:
        rows.append(("no-return", f"{100 * found.invalid_share:.1f} % of the beams"))
    if found.intensities is not None:
        rows.append(("intensity", _intensity(*found.intensities)))
    for x, y, heading in found.mounts:
        rows.append(("lidar", f"mounted at x {x:z.3f} m, y {y:z.3f} m, heading {math.degrees(heading):z.1f} degrees"))
    driven = f", {found.path_length:.1f} m driven" if found.odometry else ""
    rows.append(
        ("odometry", _count(found.odometry, found.odometry_rate) + driven + _source(found.report.odometry_topic))
    )
    if found.yaw_rates:
        source = _source(found.report.gyroscope_topic)
        rows.append(("gyroscope", _count(found.yaw_rates, found.gyroscope_rate) + source))
    rows += [("timing", text) for text in timing.findings()]
    if found.ground_truth:
        rows.append(("true poses", str(found.ground_truth)))
    rows += [("read as", text) for text in [*found.report.interpretations, *timing.corrections()]]
    rows += [("corrected", f"{text} ({counted(count, 'time')})") for text, count in found.report.corrected.items()]
    if settings := timing.settings():
        rows.append(("live, ros", " ".join(f"--set {shlex.quote(setting)}" for setting in settings)))
    rows += [("warning", text) for text in [*timing.doubts(), *found.warnings]]
    return [printable(line) for line in [found.name, *(f"  {name:<12}{text}" for name, text in rows)]]


def _time(found: RecordingInfo) -> str:
    if found.start is None:
        return "no measurements"
    start = f"{found.start:.3f} s"
    if found.start > MIN_EPOCH_STAMP:
        start = f"{datetime.fromtimestamp(found.start, UTC):%Y-%m-%d %H:%M:%S} UTC ({start})"
    return f"{found.duration:.1f} s from {start}"


def _intensity(low: float, high: float) -> str:
    """Return what is known of the intensities, of which these are the least and the largest."""
    if low == high:
        return f"{high:g} for all returns: not measured"
    measured = high <= 0.0 or MIN_INTENSITY < high < MAX_INTENSITY
    return f"{low:g} to {high:g}" + (
        ", in the lidar's own unit" if measured else ": memory that the driver did not set"
    )


def _count(count: int, rate: float | None) -> str:
    return f"{count}" if rate is None else f"{count}, {rate:.3g} per second"


def _source(topic: str | None) -> str:
    return "" if topic is None else f", from {topic}"
