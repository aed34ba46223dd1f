"""`wclm record`: recording of devices."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..device_options import BaseOption, LidarOption, check_recording_file, parse_device_options
from ..options import DurationOption, OverwriteOption

if TYPE_CHECKING:
    from drivers.devices.acquisition import Acquisition
    from drivers.devices.snapshot import Snapshot


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

    specs = parse_device_options(lidar, base)
    check_recording_file(file, overwrite, "FILE.mcap")
    with Acquisition(specs, file, deliver=False) as acquisition:
        _wait(acquisition, duration)
    typer.echo(summary(file, acquisition.snapshot))


def summary(file: Path, snapshot: Snapshot) -> str:
    """Return a summary of the recording in one line. Raises RecordingError if it ended early."""
    from drivers.devices.snapshot import RecordingStatus
    from drivers.errors import RecordingError

    recorded = snapshot.recording or RecordingStatus()
    if recorded.problem:
        kept = f"{recorded.problem}; the recording ends after {recorded.duration:.1f} s and is readable"
        raise RecordingError(file, None, kept)
    lost = sum(device.counters["losses"] for device in snapshot.devices)
    missed = snapshot.dropped + snapshot.late
    return (
        f"{file}: {recorded.scans} scans and {recorded.odometry} odometry readings in {recorded.duration:.1f} s"
        f"; {lost} connections lost, {missed} messages dropped"
    )


def _wait(acquisition: Acquisition, duration: float | None) -> None:
    """Show the status of the devices until the recording ends."""
    from ..acquisition_loop import receive_messages, stop_on_signals
    from ..device_monitor import DeviceMonitor

    with stop_on_signals(acquisition), DeviceMonitor() as monitor:

        def after_each() -> None:
            snapshot = acquisition.snapshot
            monitor.show(snapshot)
            if snapshot.recording is not None and snapshot.recording.problem:
                acquisition.stop()

        for _ in receive_messages(acquisition, duration, after_each):
            pass
