"""Input of `wclm ros`: the messages of a link to ROS 2."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from drivers.messages import Odometry, Scan, SourceReport
from drivers.ros2.receiver import MAX_WAITING_SCANS, NO_MOUNT, PAUSED, THROTTLED

from ...preprocessing.deskew import lidar_mount
from ...reporting.input_statistics import shift_after
from ...ros.run_control import Restart, RestartRequestedError, Save, SetMode
from ...run_setup import RunSetup
from ..acquisition_loop import receive_messages, stop_on_signals
from ..console import print_message

if TYPE_CHECKING:
    from drivers.messages import Message
    from drivers.ros2.receiver import RosReceiver

    from ...config import Config
    from ...events import Sink
    from ...ros.outputs import NodeOutputs
    from ...ros.run_control import RunControl
    from ..mode_switch import ModeSwitch

EXPECTED = (PAUSED, THROTTLED, NO_MOUNT)
"""Reasons for which messages are dropped that the user has set, or that are named in another way."""
STOP_MESSAGE = "stopping; Ctrl-C again discards the map"


class DiscardedError(Exception):
    """The run has ended, and its results are not wanted."""


class _ContinuationError(Exception):
    """The run ends here, and another one continues its map."""


class RosInput:
    """A `RunInput` from ROS 2, which reports missing topics and transforms.

    The run ends, too, if the clock is set back: normally if its map has changed, else by RestartRequestedError.

    start     settings, and the session that the run continues, if any
    duration  seconds; None: until a signal arrives
    keep      false: the run is discarded at its end, by DiscardedError
    control   requests: those for another map end the run by RestartRequestedError, those to save it normally
    modes     switch between mapping and localisation
    """

    finite = False
    reopen = None

    def __init__(
        self,
        receiver: RosReceiver,
        outputs: NodeOutputs,
        start: RunSetup,
        *,
        duration: float | None,
        keep: bool,
        control: RunControl,
        modes: ModeSwitch,
        sinks: Sequence[Sink],
    ) -> None:
        self.name = f"ROS 2: {', '.join(receiver.inputs.scan_topics)}"
        self.sinks: Sequence[Sink] = (*sinks, outputs)
        self._receiver = receiver
        self._outputs, self._start = outputs, start
        self._duration, self._keep, self._control = duration, keep, control
        self._modes = modes
        self._missing: list[str] = []
        self._named = {*EXPECTED, *receiver.report.reasons}  # reasons for which messages were dropped
        self._idle: Callable[[], None] = lambda: None

    @property
    def report(self) -> SourceReport:
        """Report of the receiver."""
        return self._receiver.report

    @contextmanager
    def opened(self, idle: Callable[[], None]) -> Iterator[Iterable[Message]]:
        """Provide the messages that arrive from now on, until SIGINT, SIGTERM or SIGHUP."""
        self._idle = idle
        self._outputs.begin(self._start.resumed, self._start.config.lidar.delay or 0.0)
        try:
            with stop_on_signals(self._receiver, STOP_MESSAGE):
                yield self._messages()
        finally:
            self._outputs.end()

    def resolve(self, config: Config) -> Config:
        """Return the settings unchanged."""
        return config

    def facts(self) -> dict[str, Any]:
        """Return nothing: there are no devices."""
        return {}

    def _messages(self) -> Iterator[Message]:
        try:
            for message in self._odometry_first():
                if isinstance(message, Scan):
                    mount = lidar_mount(message, self._start.config.of_lidar(message.lidar))
                    self._outputs.lidars[message.lidar] = mount[:2]
                yield message
        except _ContinuationError:
            return
        if not self._keep:
            raise DiscardedError

    def _odometry_first(self) -> Iterator[Message]:
        """Yield the messages; the first one is odometry, whose stamp shows if time goes on after the session.

        Without odometry it is the first scan.
        """
        first = Odometry if self._receiver.inputs.uses_odometry else Scan
        held: list[Message] | None = []
        session = self._start.resumed
        after = float("-inf") if session is None else session.latest
        for message in receive_messages(self._receiver, self._duration, self._after_each):
            if held is None:
                yield message
            elif isinstance(message, first):
                self._outputs.shift = shift_after(message.stamp, after)
                yield from (message, *held)
                held = None
            else:
                held = [*held[-MAX_WAITING_SCANS:], message]
        yield from held or ()

    def _after_each(self) -> None:
        """End the run if a service requests it or the clock is set back; print what is missing when that changes, and
        each reason for which messages are dropped once.
        """
        self._idle()
        if isinstance(self._control.pending, Restart):
            raise RestartRequestedError
        if isinstance(self._control.pending, Save):
            if self._modes.extends_map:
                raise _ContinuationError
            print_message("serialize_map: the map is only localised in and does not change; nothing is written")
            self._control.answer(False)
        if isinstance(self._control.pending, SetMode):
            self._control.answer(self._modes.set(self._control.pending.frozen))
        if self._receiver.clock_was_set_back:
            raise _ContinuationError if self._modes.extends_map else RestartRequestedError
        missing = self._receiver.missing()
        self._outputs.report_missing(missing)
        if missing != self._missing:
            news = [line for line in missing if line not in self._missing]
            for line in news if missing else ["scans, odometry and transforms arrive"]:
                print_message(line)
            self._missing = missing
        for reason in tuple(self.report.reasons):  # other threads add to it
            if reason not in self._named:
                self._named.add(reason)
                print_message(f"a message was dropped: {reason}")
