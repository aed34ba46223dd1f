"""`wclm info`: what is in a recording, and what is wrong with it."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from drivers import RecordingInfo

CALENDAR = 1e8
"""Seconds; stamps from here on (1973) are taken for dates, earlier ones for the time since something started."""


def info(
    recording: Annotated[str, typer.Argument(help="A recording, as for `wclm run`.")],
) -> None:
    """Say what a recording holds and what is odd about it: rates, gaps, stamps, beams, odometry.

    Example: [bold]wclm info intel.clf[/bold]
    """
    import drivers

    typer.echo("\n".join(describe(drivers.inspect(drivers.open(recording)))))


def describe(found: RecordingInfo) -> list[str]:
    """The lines that a person reads; what the recording does not tell is left out."""
    rows = [("time", _time(found))]
    rows.append(("scans", _count(found.scans, found.scan_rate)))
    if found.beams and found.field_of_view:
        few, many = found.beams
        first, last = (math.degrees(angle) for angle in found.field_of_view)
        rows.append(("beams", f"{few if few == many else f'{few} to {many}'} from {first:.1f} to {last:.1f} degrees"))
    if found.ranges and found.range_limits:
        rows.append(
            (
                "ranges",
                f"{found.ranges[0]:.2f} to {found.ranges[1]:.2f} m; the sensor states "
                f"{found.range_limits[0]:g} to {found.range_limits[1]:g} m",
            )
        )
    if found.invalid_share is not None:
        rows.append(("no return", f"{100 * found.invalid_share:.1f} % of the beams"))
    for x, y, heading in found.mounts:
        rows.append(("lidar", f"at x {x:.3f} m, y {y:.3f} m on the robot, turned {math.degrees(heading):.1f} degrees"))
    rows.append(("odometry", _count(found.odometry, found.odometry_rate) + f", {found.path_length:.1f} m driven"))
    if found.ground_truth:
        rows.append(("true poses", str(found.ground_truth)))
    rows += [("warning", text) for text in found.warnings]
    return [found.name] + [f"  {name:<12}{text}" for name, text in rows]


def _time(found: RecordingInfo) -> str:
    if found.start is None:
        return "no measurement"
    start = f"{found.start:.3f} s"
    if found.start > CALENDAR:
        start = f"{datetime.fromtimestamp(found.start, UTC):%Y-%m-%d %H:%M:%S} UTC ({start})"
    return f"{found.duration:.1f} s from {start}"


def _count(count: int, rate: float | None) -> str:
    return f"{count}" if rate is None else f"{count}, {rate:.3g} a second"
