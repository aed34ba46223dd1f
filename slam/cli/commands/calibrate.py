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
        typer.Option(
            "--wheel-radius", min=0.001, max=10, help="Wheel radius in metres with which the odometry was recorded."
        ),
    ] = None,
    track: Annotated[
        float | None,
        typer.Option(
            "--track", min=0.001, max=100, help="Distance between the wheels in metres, of the recorded odometry."
        ),
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

    if (wheel_radius is None) != (track is None):
        raise typer.BadParameter("both or none are required", param_hint="--wheel-radius / --track")
    effective = load_config(config, settings or ())
    source = drivers.open(recording, lidar_selection(effective.lidar), odometry_topic=effective.odometry.topic)
    timing = RecordingTiming.of(source, effective.lidar)
    try:
        result = estimate(progress(source, len(source), "reading"), timing.compensated(effective))
    except MapError as error:
        raise MapError(f"{recording}: {error}") from error
    wheels = None if wheel_radius is None or track is None else (wheel_radius, track)
    read_as = [f"read as   {text}" for text in source.report.interpretations]
    typer.echo("\n".join([*_estimates(result, timing), *read_as, *_options(result, timing, wheels)]))


def _estimates(result: Calibration, timing: RecordingTiming) -> list[str]:
    """Return a line for each estimate, with standard errors, and one for the data that it rests on."""
    x, y, heading = result.mount
    wheels, sigma = result.odometry, result.sigma
    bias, bias_sigma = result.range_bias
    return [
        f"mount     {x:z.4f} ± {sigma[0]:.4f} m, {y:z.4f} ± {sigma[1]:.4f} m, {heading:z.4f} ± {sigma[2]:.4f} rad",
        f"length    {wheels.length:.4f} ± {sigma[3]:.4f} m per metre of odometry",
        f"turning   {wheels.turning:.4f} ± {sigma[4]:.4f} rad per radian of odometry",
        f"veer      {wheels.veer:z.4f} ± {sigma[5]:.4f} rad to the left per metre, unmeasured by the odometry",
        f"bias      {bias:z.4f} ± {bias_sigma:.4f} m of the ranges",
        *_delay(timing),
        f"data      {result.pairs} motions between keyframes, {result.turned:.0f} rad of rotation",
    ]


def _delay(timing: RecordingTiming) -> list[str]:
    """Return the line for the lidar's delay, and why it is not compensated, if it is not; none if none was found."""
    if timing.delay is None:
        return []
    seconds, sigma, objection = timing.delay.seconds, timing.delay.sigma, timing.delay.objection
    reason = "" if objection is None else f"; not compensated: {objection}"
    return [f"delay     {seconds:z.4f} ± {sigma:.4f} s of the lidar against odometry{reason}"]


def _options(result: Calibration, timing: RecordingTiming, wheels: tuple[float, float] | None) -> list[str]:
    """Return the options that state the estimates.

    wheels  radius of both wheels and the track with which the odometry was recorded, metres, if they are known
    """
    mount = ",".join(f"{value:z.4f}" for value in result.mount)
    live = [setting for setting in timing.settings() if not setting.startswith("lidar.mount")]
    lines = [" ".join([f"wclm live: --lidar 'TYPE:PORT?mount={mount}'", *(f"--set {setting}" for setting in live)])]
    if wheels is not None:
        radius, track = wheels
        odometry = result.odometry
        true_track = track * odometry.length / odometry.turning
        half = odometry.veer * true_track / 2
        left, right = radius * (odometry.length - half), radius * (odometry.length + half)
        lines.append(f"wclm live: --base 'TYPE:PORT?wheel_radius={left:.5f},{right:.5f}&track={true_track:.4f}'")
    settings = f"--set 'lidar.mount=[{mount}]' --set lidar.range_bias={result.range_bias[0]:z.4f}"
    if timing.delay is not None and timing.delay.objection is None:
        settings += f" --set lidar.delay={timing.delay.seconds:.4f}"
    return [*lines, f"wclm run: {settings}"]
