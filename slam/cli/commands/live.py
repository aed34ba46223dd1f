"""`wclm live`: SLAM on the robot."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..console import print_message
from ..device_options import BaseOption, LidarOption, check_recording_name, parse_device_options
from ..options import (
    ConfigOption,
    ContinueOption,
    DurationOption,
    LocalizeOption,
    OutOption,
    OverwriteOption,
    PlotOption,
    RefineOption,
    ReviewOption,
    SetOption,
)
from ..viewer import connect_command

if TYPE_CHECKING:
    from drivers.devices.acquisition import Snapshot
    from drivers.devices.recorder import Recorder
    from drivers.devices.device_spec import DeviceSpec
    from drivers.errors import DriverError
    from drivers.messages import Message

    from ...events import Sink
    from ...visualisation.rerun_log import ViewerServer

STOPPING = "stopping; the map is saved. Ctrl-C again throws it away"


def live(
    out: OutOption,
    lidar: LidarOption = None,
    base: BaseOption = None,
    record: Annotated[
        Path | None, typer.Option("--record", metavar="FILE.mcap", help="Write down all that is measured, too.")
    ] = None,
    duration: DurationOption = None,
    overwrite: OverwriteOption = False,
    refine: RefineOption = False,
    continued: ContinueOption = None,
    localized: LocalizeOption = None,
    config: ConfigOption = None,
    settings: SetOption = None,
    review: ReviewOption = True,
    serve: Annotated[
        bool, typer.Option("--serve/--no-serve", help="Let viewers look on; needs the log for the viewer.")
    ] = True,
    address: Annotated[
        str, typer.Option("--address", help="Where viewers connect: 0.0.0.0 lets other computers in.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option("--port", min=1, max=65535, help="Where viewers connect; 9877, or another if that is taken."),
    ] = None,
    plot: PlotOption = False,
) -> None:
    """Map while the robot drives, until Ctrl-C; then the path, the map and a log to look at are written.

    Example: [bold]wclm live --lidar rplidar:/dev/ttyUSB0 --base create2:/dev/ttyUSB1 --out map --record map.mcap[/bold]
    """
    from ..run_summary import format_summary
    from ..slam_run import prepare_run, run_slam

    start = prepare_run(continued, localized, config, settings)
    if not (lidar and base):
        raise typer.BadParameter("SLAM needs a lidar and a base", param_hint="--lidar / --base")
    specs = parse_device_options(lidar, base)
    if record is not None:
        check_recording_name(record, overwrite)
    with _server(address, port) if review and serve else nullcontext() as server:
        drive = Drive(specs, record, duration, server)
        result = run_slam(
            drive,
            start.config,
            out,
            overwrite=overwrite,
            review=review,
            picture=plot,
            refine=refine,
            resumed=start.resumed,
            frozen=start.frozen,
            server=server,
        )
    typer.echo("\n".join(format_summary(result, out)))
    if drive.failure is not None:
        raise drive.failure


def _server(address: str, port: int | None) -> ViewerServer:
    from ...visualisation.rerun_log import ViewerServer

    return ViewerServer(address, port)


class Drive:
    """A session's `Feed` out of devices, recorded on the way if that is asked for, and shown.

    specs      of the devices
    recording  the file to write, which is replaced
    duration   seconds; None: until it is interrupted
    server     where viewers look on

    failure  why the messages ended before they should; what was measured until then is mapped nevertheless
    """

    def __init__(
        self, specs: Sequence[DeviceSpec], recording: Path | None, duration: float | None, server: ViewerServer | None
    ) -> None:
        from drivers.devices.acquisition import Acquisition
        from drivers.messages import SourceReport

        from .live_dashboard import LiveDashboard

        self.name, self.finite = " + ".join(spec.text for spec in specs), False
        self.report = SourceReport()
        self.failure: DriverError | None = None
        self._acquisition = Acquisition(specs)
        self._recording, self._duration, self._server = recording, duration, server
        self._recorder: Recorder | None = None
        self._recorded = None if recording is None else {"file": str(recording), "problem": ""}
        self._dashboard = LiveDashboard()
        self.sinks: Sequence[Sink] = (self._dashboard,)

    @contextmanager
    def opened(self) -> Iterator[Iterable[Message]]:
        """The messages, once all devices run; Ctrl-C and being told to terminate end them.

        Raises DriverError where a device cannot be started; reading raises RecordingError where the recording cannot
        be begun.
        """
        from ..acquisition_loop import stop_on_signals

        with self._acquisition as acquisition, stop_on_signals(acquisition, STOPPING):
            self._greet()
            yield self._messages()

    @property
    def reopen(self) -> str | None:
        """The recording, if it is whole."""
        from ..run_input import absolute_source

        return absolute_source(self._recorded["file"]) if self._recorded and not self._recorded["problem"] else None

    def facts(self) -> dict[str, Any]:
        """How the devices did, and what became of the recording."""
        told = ("spec", "identity", "port", "problem", "counters")
        devices = [{name: getattr(device, name) for name in told} for device in self._acquisition.snapshot.devices]
        return {"devices": devices, "recorded": self._recorded}

    def _greet(self) -> None:
        for device in self._acquisition.snapshot.devices:
            print_message(f"{device.spec} runs: {device.identity}")
        if self._server is not None:
            print_message(f"look on with: {' '.join(connect_command(self._server.url))}")

    def _messages(self) -> Iterator[Message]:
        from drivers.devices.device_source import count_losses
        from drivers.devices.recorder import Recorder
        from drivers.errors import DriverError
        from drivers.recordings.mcap import McapWriter

        from ..acquisition_loop import receive_messages
        from ..device_monitor import DeviceMonitor

        with ExitStack() as stack:
            if self._recording is not None:
                writer = McapWriter(self._recording, overwrite=True)
                self._recorder = Recorder(writer)
                stack.callback(self._record, lambda _: writer.close())
            monitor = stack.enter_context(DeviceMonitor(self._dashboard.draw))

            def look(snapshot: Snapshot) -> None:
                monitor.show(snapshot)
                self._record(lambda recorder: recorder.look(snapshot))

            try:
                for message in receive_messages(self._acquisition, self._duration, look):
                    self.report.messages += 1
                    self._record(partial(Recorder.write, message=message))
                    yield message
            except DriverError as error:
                self.failure = error
            count_losses(self.report, self._acquisition.snapshot)
            self._record(lambda recorder: recorder.tell(self._acquisition.snapshot))

    def _record(self, write: Callable[[Recorder], None]) -> None:
        """Do something with the recorder, if there is one; the map is worth more than that it works."""
        from drivers.errors import RecordingError

        if self._recorder is None or self._recorded is None:
            return
        try:
            write(self._recorder)
        except RecordingError as error:
            print_message(f"{error}; the recording ends here and can be read, mapping goes on")
            self._recorder, self._recorded["problem"] = None, error.reason
