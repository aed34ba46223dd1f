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
    from drivers.devices.driving import DriveLimits
    from drivers.devices.snapshot import Snapshot
    from drivers.errors import DriverError
    from drivers.messages import Message

    from ...config import Config
    from ...events import Sink
    from ...io.stored_session import StoredSession
    from ..message_pump import MessagePump
    from ..run_controls import RunControls
    from ..status_file import StatusFile

STOP_MESSAGE = "stopping and saving the map; Ctrl-C again discards it"


class LiveInput:
    """A `RunInput` from devices, which records the messages and displays the state of the run.

    specs      specs of the devices
    recording  file to write, replaced if it exists; None: no recording
    duration   seconds; None: until a signal arrives
    driving    limits of driving; None: the robot is not driven
    controls   how people follow and steer the run; its page and its keys act on the devices, too
    status     file with the state of the run, if any
    earlier    session that the run continues or localises in, if any: its lidar is probably the same

    failure  error that ended the messages early, if any; the messages before it are mapped
    """

    def __init__(
        self,
        specs: Sequence[DeviceSpec],
        recording: Path | None,
        duration: float | None,
        driving: DriveLimits | None,
        controls: RunControls,
        status: StatusFile | None = None,
        earlier: StoredSession | None = None,
    ) -> None:
        from drivers.devices.acquisition import Acquisition
        from drivers.messages import SourceReport
        from drivers.timing.beam_times import STATED

        from ...pose_extrapolation import PoseExtrapolator
        from ..teleoperation import HELP, Teleoperation
        from .live_dashboard import LiveDashboard
        from .live_web import PageControl

        self.name, self.finite = " + ".join(spec.text for spec in specs), False
        self.report = SourceReport()
        self.failure: DriverError | None = None
        several = sum(spec.is_lidar for spec in specs) > 1  # whose scans must come in the order of their stamps
        self._acquisition = Acquisition(specs, recording, driving=driving, in_order=several)
        self._server, self._page, self._status = controls.server, (page := controls.page), status
        self._control = None if page is None else PageControl(page, self._acquisition, driving)
        if page is not None:
            page.state.poses_of_scans = all(spec.is_lidar for spec in specs)
        self._duration, self._driving = duration, driving
        self._recorded = None if recording is None else {"file": str(recording), "problem": ""}
        self._dashboard = LiveDashboard("" if driving is None else HELP)
        if driving is not None:
            controls.keys.add(Teleoperation(self._acquisition, driving).handle)
        mount_stated = any("mount" in spec.options for spec in specs if spec.is_lidar)
        self._earlier_mount = None if earlier is None or mount_stated else earlier.last_mount
        self._extrapolator = PoseExtrapolator()
        self._beam_times = [STATED, STATED]  # of each lidar
        self.sinks: Sequence[Sink] = (self._dashboard, self._extrapolator, *([] if status is None else [status]))

    @contextmanager
    def opened(self, idle: Callable[[], None]) -> Iterator[Iterable[Message]]:
        """Start the devices and provide their messages until SIGINT, SIGTERM or SIGHUP.

        Raises DriverError if a device cannot be started or the recording cannot be created.
        """
        from ..acquisition_loop import stop_on_signals
        from ..message_pump import MessagePump
        from ..switch_interval import short_switch_interval

        with (
            self._acquisition as acquisition,
            short_switch_interval(),
            MessagePump(acquisition, self._show_pose) as pump,
            stop_on_signals(pump, STOP_MESSAGE),
        ):
            self._print_devices()
            yield self._messages(pump, idle)

    @property
    def reopen(self) -> str | None:
        """Path of the recording; None if there is none or it is incomplete."""
        from ...io.recordings import absolute_recording

        return absolute_recording(self._recorded["file"]) if self._recorded and not self._recorded["problem"] else None

    def resolve(self, config: Config) -> Config:
        """Return the settings with the mount of the session if nothing else states it.

        Devices or settings state the times of measurements.
        """
        from drivers.timing.beam_times import STATED, set_beam_times

        self._extrapolator.delay = config.lidar.delay or 0.0
        self._beam_times = [
            set_beam_times(lidar.beam_order, lidar.turn_period) or STATED
            for lidar in (config.lidar, config.second_lidar)
        ]
        if self._earlier_mount is not None and config.lidar.mount is None:
            from ...io.recording_timing import mounted_as_in_session

            print_message(mounted_as_in_session(self._earlier_mount))
            config = config.with_mount(self._earlier_mount)
        return config

    def facts(self) -> dict[str, Any]:
        """Return the final state of the devices and of the recording."""
        fields = ("spec", "identity", "port", "problem", "counters")
        devices = [{name: getattr(device, name) for name in fields} for device in self._acquisition.snapshot.devices]
        return {"devices": devices, "recorded": self._recorded}

    def _print_devices(self) -> None:
        for device in self._acquisition.snapshot.devices:
            print_message(f"{device.spec} connected: {device.identity}")
        if self._driving is not None:
            print_message(f"driving at {self._driving.speed:g} m/s and {self._driving.turn_rate:g} rad/s at most")
        if self._server is not None:
            print_message(f"view with: {' '.join(connect_command(self._server.url))}")
        if self._page is not None:
            print_message(f"open in a browser: {self._page.url}")

    def _show_pose(self, message: Message) -> None:
        """Show the pose at an odometry reading that has arrived, in the thread of the pump."""
        from drivers.messages import Odometry

        if self._page is not None and isinstance(message, Odometry):
            pose = self._extrapolator.at(message)
            if pose is not None:
                self._page.state.put_pose(pose.stamp, pose.pose, pose.covariance)

    def _messages(self, pump: MessagePump, idle: Callable[[], None]) -> Iterator[Message]:
        from drivers.devices.device_source import count_losses
        from drivers.errors import DriverError
        from drivers.messages import Scan

        from ..acquisition_loop import receive_messages
        from ..device_monitor import DeviceMonitor

        with DeviceMonitor(self._dashboard.render) as monitor:

            def after_each() -> None:
                snapshot = self._acquisition.snapshot
                monitor.show(snapshot)
                if self._control is not None:
                    self._control.show(snapshot)
                if self._status is not None:
                    self._status.show(snapshot)
                self._check_recording(snapshot)
                idle()

            try:
                for message in receive_messages(pump, self._duration, after_each):
                    self.report.messages += 1
                    yield self._beam_times[message.lidar].of(message) if isinstance(message, Scan) else message
            except DriverError as error:
                self.failure = error
            self._check_recording(self._acquisition.snapshot)
            count_losses(self.report, self._acquisition.snapshot)
            if self._status is not None:
                self._status.close(self._acquisition.snapshot, "" if self.failure is None else str(self.failure))

    def _check_recording(self, snapshot: Snapshot) -> None:
        """Print a problem of the recording once: it ends the recording but not the mapping."""
        if snapshot.recording is None or self._recorded is None:
            return
        problem = snapshot.recording.problem
        if problem and not self._recorded["problem"]:
            self._recorded["problem"] = problem
            file = self._recorded["file"]
            print_message(f"{file}: {problem}; the recording ends here and is readable, mapping continues")
