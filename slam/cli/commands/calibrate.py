"""`wclm calibrate`: mount and range bias of the lidar and scales of the odometry, from a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from ...io.output_dir import refuse_results
from ..console import progress
from ..options import ConfigOption, SetOption

if TYPE_CHECKING:
    from ...io.recording_timing import RecordingTiming
    from ...offline.calibration.extrinsics import Calibration


def calibrate(
    recording: Annotated[
        str,
        typer.Argument(
            metavar="RECORDING", callback=refuse_results, help="Recording with left and right turns, as for `wclm run`."
        ),
    ],
    wheel_radius: Annotated[
        float | None,
        typer.Option("--wheel-radius", min=0.001, help="Wheel radius in metres with which the odometry was recorded."),
    ] = None,
    track: Annotated[
        float | None,
        typer.Option("--track", min=0.001, help="Distance between the wheels in metres, of the recorded odometry."),
    ] = None,
    config: ConfigOption = None,
    settings: SetOption = None,
) -> None:
    """Estimate the lidar's mount and range bias and the odometry's scales from a recording.

    The search starts from the mount in the recording or in lidar.mount, whose heading may be any. All results have
    standard errors. With --wheel-radius and --track the corrected values are printed, too.

    The lidar's delay against odometry is estimated, too, and compensated as `wclm run` does.

    Example: [bold]wclm calibrate drive.mcap --wheel-radius 0.033 --track 0.2[/bold]
    """
    import drivers

    from ...config import load_config
    from ...errors import MapError
    from ...io.recording_timing import RecordingTiming
    from ...io.recordings import lidar_selection
    from ...offline.calibration.extrinsics import calibrate as estimate

    effective = load_config(config, settings or ())
    source = drivers.open(recording, lidar_selection(effective.lidar))
    timing = RecordingTiming.of(source, effective.lidar)
    try:
        result = estimate(progress(source, len(source), "reading"), timing.compensated(effective))
    except MapError as error:
        raise MapError(f"{recording}: {error}") from error
    typer.echo("\n".join([*_lines(result), *_timing_lines(timing)]))
    if wheel_radius is not None and track is not None:
        typer.echo(_options(result, wheel_radius, track))


def _lines(result: Calibration) -> list[str]:
    x, y, heading = result.mount
    wheels, sigma = result.odometry, result.sigma
    bias, bias_sigma = result.range_bias
    return [
        f"mount     {x:.4f} ± {sigma[0]:.4f} m, {y:.4f} ± {sigma[1]:.4f} m, {heading:.4f} ± {sigma[2]:.4f} rad",
        f"length    {wheels.length:.4f} ± {sigma[3]:.4f} m per metre of odometry",
        f"turning   {wheels.turning:.4f} ± {sigma[4]:.4f} rad per radian of odometry",
        f"veer      {wheels.veer:.4f} ± {sigma[5]:.4f} rad to the left per metre, unmeasured by the odometry",
        f"bias      {bias:.4f} ± {bias_sigma:.4f} m of the ranges",
        f"data      {result.pairs} motions between keyframes, {result.turned:.0f} rad of rotation",
        f"wclm live: --lidar 'TYPE:PORT?mount={x:.4f},{y:.4f},{heading:.4f}'",
        f"wclm run: --set 'lidar.mount=[{x:.4f},{y:.4f},{heading:.4f}]' --set lidar.range_bias={bias:.4f}",
    ]


def _timing_lines(timing: RecordingTiming) -> list[str]:
    """Return the lidar's delay, and the setting that compensates it or why none is needed, if a delay was found."""
    if timing.delay is None:
        return []
    seconds, sigma, objection = timing.delay.seconds, timing.delay.sigma, timing.delay.objection
    line = f"delay     {seconds:.4f} ± {sigma:.4f} s of the lidar against odometry"
    if objection is not None:
        return [f"{line}; not compensated: {objection}"]
    return [line, f"wclm run: --set lidar.delay={seconds:.4f}"]


def _options(result: Calibration, wheel_radius: float, track: float) -> str:
    """Return the option of the base with corrected dimensions: the radius of each wheel and the track."""
    wheels = result.odometry
    true_track = track * wheels.length / wheels.turning
    half = wheels.veer * true_track / 2
    left, right = wheel_radius * (wheels.length - half), wheel_radius * (wheels.length + half)
    return f"wclm live: --base 'TYPE:PORT?wheel_radius={left:.5f},{right:.5f}&track={true_track:.4f}'"
