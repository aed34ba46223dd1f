"""Input of `wclm live`: messages of devices, recorded and displayed on the way."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..console import print_message
from ..viewer import connect_command

if TYPE_CHECKING:
    from drivers.devices.device_spec import DeviceSpec
    from drivers.devices.recorder import Recorder
    from drivers.errors import DriverError
    from drivers.messages import Message

    from ...config import Config
    from ...events import Sink
    from ...visualisation.rerun_log import ViewerServer

STOP_MESSAGE = "stopping and saving the map; Ctrl-C again discards it"


class LiveInput:
    """A `RunInput` from devices, which records the messages and displays the state of the run.

    specs      specs of the devices
    recording  file to write, replaced if it exists; None: no recording
    duration   seconds; None: until a signal arrives
    server     address where viewers can connect, if any

    failure  error that ended the messages early, if any; the messages before it are mapped
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
        """Start the devices and provide their messages until SIGINT or SIGTERM.

        Raises DriverError if a device cannot be started. Iterating raises RecordingError if the recording cannot be
        created.
        """
        from ..acquisition_loop import stop_on_signals

        with self._acquisition as acquisition, stop_on_signals(acquisition, STOP_MESSAGE):
            self._print_devices()
            yield self._messages()

    @property
    def reopen(self) -> str | None:
        """Path of the recording; None if there is none or it is incomplete."""
        from ...io.recordings import absolute_recording

        return absolute_recording(self._recorded["file"]) if self._recorded and not self._recorded["problem"] else None

    def resolve(self, config: Config) -> Config:
        """Return the settings unchanged: devices state the times of their measurements."""
        return config

    def facts(self) -> dict[str, Any]:
        """Return the final state of the devices and of the recording."""
        fields = ("spec", "identity", "port", "problem", "counters")
        devices = [{name: getattr(device, name) for name in fields} for device in self._acquisition.snapshot.devices]
        return {"devices": devices, "recorded": self._recorded}

    def _print_devices(self) -> None:
        for device in self._acquisition.snapshot.devices:
            print_message(f"{device.spec} connected: {device.identity}")
        if self._server is not None:
            print_message(f"view with: {' '.join(connect_command(self._server.url))}")

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
            monitor = stack.enter_context(DeviceMonitor(self._dashboard.render))

            def after_each() -> None:
                snapshot = self._acquisition.snapshot
                monitor.show(snapshot)
                self._record(lambda recorder: recorder.write_diagnostics_if_due(snapshot))

            try:
                for message in receive_messages(self._acquisition, self._duration, after_each):
                    self.report.messages += 1
                    self._record(partial(Recorder.write, message=message))
                    yield message
            except DriverError as error:
                self.failure = error
            count_losses(self.report, self._acquisition.snapshot)
            self._record(lambda recorder: recorder.write_diagnostics(self._acquisition.snapshot))

    def _record(self, write: Callable[[Recorder], None]) -> None:
        """Call `write` with the recorder, if there is one; an error ends the recording but not the mapping."""
        from drivers.errors import RecordingError

        if self._recorder is None or self._recorded is None:
            return
        try:
            write(self._recorder)
        except RecordingError as error:
            print_message(f"{error}; the recording ends here and is readable, mapping continues")
            self._recorder, self._recorded["problem"] = None, error.reason
