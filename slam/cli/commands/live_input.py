"""Input of `wclm live`: messages of devices, whose state is displayed on the way."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..console import print_message
from ..viewer import connect_command

if TYPE_CHECKING:
    from drivers.devices.device_spec import DeviceSpec
    from drivers.devices.snapshot import Snapshot
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
        self._acquisition = Acquisition(specs, recording)
        self._duration, self._server = duration, server
        self._recorded = None if recording is None else {"file": str(recording), "problem": ""}
        self._dashboard = LiveDashboard()
        self.sinks: Sequence[Sink] = (self._dashboard,)

    @contextmanager
    def opened(self, idle: Callable[[], None]) -> Iterator[Iterable[Message]]:
        """Start the devices and provide their messages until SIGINT, SIGTERM or SIGHUP.

        Raises DriverError if a device cannot be started or the recording cannot be created.
        """
        from ..acquisition_loop import stop_on_signals

        with self._acquisition as acquisition, stop_on_signals(acquisition, STOP_MESSAGE):
            self._print_devices()
            yield self._messages(idle)

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

    def _messages(self, idle: Callable[[], None]) -> Iterator[Message]:
        from drivers.devices.device_source import count_losses
        from drivers.errors import DriverError

        from ..acquisition_loop import receive_messages
        from ..device_monitor import DeviceMonitor

        with DeviceMonitor(self._dashboard.render) as monitor:

            def after_each() -> None:
                snapshot = self._acquisition.snapshot
                monitor.show(snapshot)
                self._check_recording(snapshot)
                idle()

            try:
                for message in receive_messages(self._acquisition, self._duration, after_each):
                    self.report.messages += 1
                    yield message
            except DriverError as error:
                self.failure = error
            self._check_recording(self._acquisition.snapshot)
            count_losses(self.report, self._acquisition.snapshot)

    def _check_recording(self, snapshot: Snapshot) -> None:
        """Print a problem of the recording once: it ends the recording but not the mapping."""
        if snapshot.recording is None or self._recorded is None:
            return
        problem = snapshot.recording.problem
        if problem and not self._recorded["problem"]:
            self._recorded["problem"] = problem
            file = self._recorded["file"]
            print_message(f"{file}: {problem}; the recording ends here and is readable, mapping continues")
