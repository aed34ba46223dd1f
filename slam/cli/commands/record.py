"""`wclm record`: recording of devices."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..device_options import BaseOption, LidarOption, check_recording_name, parse_device_options
from ..options import DurationOption, OverwriteOption

if TYPE_CHECKING:
    from drivers.devices.acquisition import Acquisition, Snapshot
    from drivers.devices.recorder import Recorder


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

        def after_each() -> None:
            monitor.show(acquisition.snapshot)
            recorder.write_diagnostics_if_due(acquisition.snapshot)

        try:
            for message in receive_messages(acquisition, duration, after_each):
                recorder.write(message)
            recorder.write_diagnostics(acquisition.snapshot)
        except RecordingError as error:
            kept = f"{error.reason}; the recording ends after {recorder.duration:.1f} s and is readable"
            raise RecordingError(error.path, None, kept) from error
