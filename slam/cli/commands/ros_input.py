"""Input of `wclm ros`: the messages of a link to ROS 2."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from drivers.messages import Scan, SourceReport

from ...preprocessing.deskew import lidar_mount
from ..acquisition_loop import receive_messages, stop_on_signals
from ..console import print_message
from ..slam_run import shift_after

if TYPE_CHECKING:
    from drivers.messages import Message
    from drivers.ros2.receiver import RosReceiver

    from ...config import Config, LidarConfig
    from ...events import Sink
    from ...io.sessions import StoredSession
    from ...ros.outputs import NodeOutputs

STOP_MESSAGE = "stopping; Ctrl-C again discards the map"


class DiscardedError(Exception):
    """The run has ended, and its results are not wanted."""


class RosInput:
    """A `RunInput` from ROS 2, which reports missing topics and transforms.

    lidar     settings of the lidar
    session   session that the run continues, if any
    duration  seconds; None: until a signal arrives
    keep      false: the run is discarded at its end, by DiscardedError
    """

    finite = False
    reopen = None

    def __init__(
        self,
        receiver: RosReceiver,
        outputs: NodeOutputs,
        lidar: LidarConfig,
        session: StoredSession | None,
        *,
        duration: float | None,
        keep: bool,
        sinks: Sequence[Sink] = (),
    ) -> None:
        self.name = f"ROS 2: {receiver.inputs.scan}"
        self.sinks: Sequence[Sink] = (*sinks, outputs)
        self._receiver = receiver
        self._outputs, self._lidar, self._session = outputs, lidar, session
        self._duration, self._keep = duration, keep
        self._missing: list[str] = []

    @property
    def report(self) -> SourceReport:
        """Report of the receiver."""
        return self._receiver.report

    @contextmanager
    def opened(self) -> Iterator[Iterable[Message]]:
        """Provide the messages that arrive from now on, until SIGINT or SIGTERM."""
        self._outputs.begin(self._session)
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
        after = float("-inf") if self._session is None else self._session.latest
        first = True
        for message in receive_messages(self._receiver, self._duration, self._report_missing):
            if first:
                self._outputs.shift, first = shift_after(message.stamp, after), False
            if isinstance(message, Scan):
                self._outputs.lidar = lidar_mount(message, self._lidar)[:2]
            yield message
        if not self._keep:
            raise DiscardedError

    def _report_missing(self) -> None:
        """Print what is missing when that changes."""
        missing = self._receiver.missing()
        if missing != self._missing:
            news = [line for line in missing if line not in self._missing]
            for line in news if missing else ["scans, odometry and transforms arrive"]:
                print_message(line)
            self._missing = missing
