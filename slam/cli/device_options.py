"""Options of the commands that open devices, and checks of them before any device starts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.devices.device_spec import DeviceSpec
    from drivers.devices.driving import DriveLimits

MIN_FREE_SPACE = 10_000_000
"""Bytes free for a recording at its start: more than a minute of driving."""

LidarOption = Annotated[
    list[str] | None,
    typer.Option("--lidar", metavar="SPEC", help="Lidar, e.g. rplidar:/dev/ttyUSB0 or ld06:auto."),
]
BaseOption = Annotated[
    list[str] | None, typer.Option("--base", metavar="SPEC", help="Wheel base, e.g. create2:/dev/ttyUSB1.")
]


MaxSpeedOption = Annotated[
    float | None, typer.Option("--max-speed", help="With --drive: highest speed, m/s; by default 0.2.")
]
MaxTurnRateOption = Annotated[
    float | None, typer.Option("--max-turn-rate", help="With --drive: highest turn rate, rad/s; by default 1.0.")
]


def parse_drive_options(
    drive: bool, max_speed: float | None, max_turn_rate: float | None, specs: Sequence[DeviceSpec]
) -> DriveLimits | None:
    """Return the limits of `--drive`, None without that option.

    Raises DriverError if a limit is not positive or there is not exactly one base, or BadParameter for a limit without
    `--drive`.
    """
    from drivers.devices.driving import DriveLimits, driven_base

    if not drive:
        if max_speed is not None or max_turn_rate is not None:
            raise typer.BadParameter("has no effect without --drive", param_hint="--max-speed / --max-turn-rate")
        return None
    driven_base(specs)
    default = DriveLimits()
    return DriveLimits(
        default.speed if max_speed is None else max_speed,
        default.turn_rate if max_turn_rate is None else max_turn_rate,
    )


def parse_device_options(lidar: list[str] | None, base: list[str] | None) -> list[DeviceSpec]:
    """Parse the specs of `--lidar` and `--base`.

    Raises SpecError, or BadParameter if no device is given or one is given under the wrong option.
    """
    from drivers.devices.device_spec import check_robot, parse_devices

    texts = [*(lidar or ()), *(base or ())]
    if not texts:
        raise typer.BadParameter("at least one device is required", param_hint="--lidar / --base")
    for option, is_lidar, given in (("--lidar", True, lidar), ("--base", False, base)):
        for spec in parse_devices(" + ".join(given)) if given else ():
            if spec.is_lidar != is_lidar:
                name, other = ("lidar", "--lidar") if spec.is_lidar else ("wheel base", "--base")
                raise typer.BadParameter(f"{spec.text} is a {name}, for {other}", param_hint=option)
    specs = parse_devices(" + ".join(texts))
    check_robot(specs)
    return specs


def check_recording_file(file: Path, overwrite: bool, option: str) -> None:
    """Check that a recording can be written to this file, which an option names.

    Raises BadParameter or RecordingError.
    """
    from drivers.errors import RecordingError

    from ..io.disk_reserve import free_space

    if file.suffix != ".mcap":
        raise typer.BadParameter(f"{file}: the name must end with .mcap", param_hint=option)
    if not file.parent.is_dir():
        raise RecordingError(file, None, "cannot be written: its directory does not exist")
    if file.exists() and not overwrite:
        raise RecordingError(file, None, "exists already; choose another name or add --overwrite")
    if (free := free_space(file.parent)) < MIN_FREE_SPACE:
        reason = f"{free / 1e6:.0f} MB are free there, and at least {MIN_FREE_SPACE / 1e6:.0f} MB are needed"
        raise RecordingError(file, None, reason)
