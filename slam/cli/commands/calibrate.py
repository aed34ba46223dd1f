"""`wclm calibrate`: where the lidar sits and what the wheels measure wrongly, from a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from ..console import progress
from ..options import ConfigOption, SetOption

if TYPE_CHECKING:
    from ...offline.calibration.extrinsics import Calibration


def calibrate(
    recording: Annotated[str, typer.Argument(help="A drive with curves both ways, as for `wclm run`.")],
    wheel_radius: Annotated[
        float | None, typer.Option("--wheel-radius", min=0.0, help="What it was recorded with, metres.")
    ] = None,
    track: Annotated[float | None, typer.Option("--track", min=0.0, help="What it was recorded with, metres.")] = None,
    config: ConfigOption = None,
    settings: SetOption = None,
) -> None:
    """Estimate the lidar's mount, what its ranges are too long by, the wheels' radius and the track from a drive.

    The mount that the recording or lidar.mount states is where the search begins; its heading should be right to 20
    degrees. All come with standard errors. With the radius and the track that the odometry was made with, the right
    ones are told, too.

    Example: [bold]wclm calibrate drive.mcap --wheel-radius 0.033 --track 0.2[/bold]
    """
    import drivers

    from ...config import load_config
    from ...offline.calibration.extrinsics import calibrate as estimate

    effective = load_config(config, settings or ())
    source = drivers.open(recording)
    result = estimate(progress(source, len(source), "reading"), effective)
    typer.echo("\n".join(_lines(result)))
    if wheel_radius is not None and track is not None:
        typer.echo(_options(result, wheel_radius, track))


def _lines(result: Calibration) -> list[str]:
    x, y, heading = result.mount
    wheels, sigma = result.wheels, result.sigma
    bias, bias_sigma = result.range_bias
    return [
        f"mount     {x:.4f} ± {sigma[0]:.4f} m, {y:.4f} ± {sigma[1]:.4f} m, {heading:.4f} ± {sigma[2]:.4f} rad",
        f"distance  {wheels.distance:.4f} ± {sigma[3]:.4f} m for each metre that the odometry tells",
        f"turn      {wheels.turn:.4f} ± {sigma[4]:.4f} rad for each radian that it tells",
        f"pull      {wheels.pull:.4f} ± {sigma[5]:.4f} rad to the left in each metre, which it does not tell",
        f"ranges    {bias:.4f} ± {bias_sigma:.4f} m too long",
        f"from      {result.pairs} motions between keyframes, {result.turned:.0f} rad turned",
        f"lidar: mount={x:.4f},{y:.4f},{heading:.4f}",
        f"wclm run: --set lidar.range_bias={bias:.4f}",
    ]


def _options(result: Calibration, wheel_radius: float, track: float) -> str:
    """The base's options as they should be: the wheels by their mean and by what they differ."""
    wheels = result.wheels
    true_track = track * wheels.distance / wheels.turn
    half = wheels.pull * true_track / 2
    left, right = wheel_radius * (wheels.distance - half), wheel_radius * (wheels.distance + half)
    return f"base: wheel_radius={left:.5f},{right:.5f}&track={true_track:.4f}"
