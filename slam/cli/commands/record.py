"""`wclm record`: recording of devices."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..options import DurationOption, OverwriteOption

if TYPE_CHECKING:
    from drivers.devices.acquisition import Acquisition, Snapshot
    from drivers.devices.device_spec import DeviceSpec
    from drivers.devices.recorder import Recorder

LidarOption = Annotated[
    list[str] | None, typer.Option("--lidar", metavar="SPEC", help="Such as rplidar:/dev/ttyUSB0, ld06:auto.")
]
BaseOption = Annotated[list[str] | None, typer.Option("--base", metavar="SPEC", help="Such as create2:/dev/ttyUSB1.")]


def record(
    file: Annotated[Path, typer.Argument(metavar="FILE.mcap", help="Recording to write.")],
    lidar: LidarOption = None,
    base: BaseOption = None,
    duration: DurationOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Record a lidar and a wheel base until Ctrl-C.

    If the command is killed, the file is complete up to the last second.

    Example: [bold]wclm record --lidar rplidar:/dev/ttyUSB0 --base create2:/dev/ttyUSB1 drive.mcap[/bold]
    """
    from drivers.devices.acquisition import Acquisition
    from drivers.devices.recorder import Recorder
    from drivers.recordings.mcap import McapWriter

    specs = parse_device_options(lidar, base)
    check_recording_name(file, overwrite)
    with Acquisition(specs) as acquisition, McapWriter(file, overwrite) as writer:
        recorder = Recorder(writer)
        _record(acquisition, recorder, duration)
    typer.echo(summary(file, recorder, acquisition.snapshot))


def check_recording_name(file: Path, overwrite: bool) -> None:
    """See before anything turns whether a recording may have this name; raises BadParameter or RecordingError."""
    from drivers.errors import RecordingError

    if file.suffix != ".mcap":
        raise typer.BadParameter(f"{file}: the name of a recording must end with .mcap")
    if file.exists() and not overwrite:
        raise RecordingError(file, None, "exists already; choose another name or add --overwrite")


def parse_device_options(lidar: list[str] | None, base: list[str] | None) -> list[DeviceSpec]:
    """The devices of both options; raises SpecError, or BadParameter where one is given as the other."""
    from drivers.devices.device_spec import parse_devices

    texts = [*(lidar or ()), *(base or ())]
    if not texts:
        raise typer.BadParameter("say which devices", param_hint="--lidar / --base")
    specs = parse_devices(" + ".join(texts))
    for spec in specs:
        if spec.is_lidar != (spec.text in [text.strip() for text in lidar or ()]):
            hint = "--base" if spec.is_lidar else "--lidar"
            raise typer.BadParameter(f"{spec.text} is a {'lidar' if spec.is_lidar else 'base'}", param_hint=hint)
    return specs


def summary(file: Path, recorder: Recorder, snapshot: Snapshot) -> str:
    """Return a summary of the recording in one line."""
    lost = sum(device.counters["losses"] for device in snapshot.devices)
    missed = snapshot.dropped + snapshot.late
    return (
        f"{file}: {recorder.scans} scans and {recorder.odometry} odometry readings in {recorder.duration:.1f} s"
        f"; {lost} connections lost, {missed} messages dropped"
    )


def _record(acquisition: Acquisition, recorder: Recorder, duration: float | None) -> None:
    from drivers.errors import RecordingError

    from ..acquisition_loop import receive_messages, stop_on_signals
    from ..device_monitor import DeviceMonitor

    with stop_on_signals(acquisition), DeviceMonitor() as monitor:

        def on_snapshot(snapshot: Snapshot) -> None:
            monitor.show(snapshot)
            recorder.write_diagnostics_if_due(snapshot)

        try:
            for message in receive_messages(acquisition, duration, on_snapshot):
                recorder.write(message)
            recorder.write_diagnostics(acquisition.snapshot)
        except RecordingError as error:
            kept = f"{error.reason}; the recording ends after {recorder.duration:.1f} s and is readable"
            raise RecordingError(error.path, None, kept) from error
