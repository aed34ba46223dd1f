"""What a recording shows of its sensors before it is read: times of beams, delays, mounts, defects of odometry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import RecordingError
from ..messages import Message, Scan, SourceReport, mirrored
from .frozen_odometry import FrozenOdometryDetector
from .odometry_speed import OdometrySpeed
from .time_ordering import sort_within

if TYPE_CHECKING:
    from ..timing.beam_order import BeamOrderTest
    from ..timing.beam_times import BeamTimes
    from ..timing.delay import Delay
    from ..timing.floor import Floor
    from ..timing.gyroscope_scale import GyroscopeScale
    from ..timing.interlacing import Interlacing
    from ..timing.mount_heading import MountHeading
    from ..timing.own_returns import OwnReturns
    from ..timing.turns import Turns
    from ..timing.upside_down import OdometryTurns

MAX_KEPT_BYTES = 1 << 26
"""Bytes of the arrays of scans up to which the messages of a survey are kept for the next iteration: most recordings of
an hour indoors. Larger ones are read again."""


@dataclass(slots=True, eq=False)
class _Survey:
    """Messages of a recording that were read before the iteration that yields them, and the report of reading them."""

    messages: deque[Message]
    report: SourceReport


class SurveyedRecording(ABC):
    """Recording whose messages are read once before it is used, to find out what is not written in it.

    path                recording
    report              of the present iteration
    set_beam_times      times of the beams that a user has set; None: they are decided from the scans
    times_known         false if the messages turn out to have no times of their own
    states_beam_times   if the format has a place for them; if not, the stamp of a scan is taken to be the middle of its
                        sweep
    """

    states_beam_times = False

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.report = SourceReport()
        self.set_beam_times: BeamTimes | None = None
        self.times_known = True
        self._survey: _Survey | None = None
        self._lost_scans = ""  # why most scans cannot be used

    @property
    def beam_times(self) -> BeamTimes:
        """Times that the beams have when the recording is read."""
        from ..timing.beam_times import STATED

        times = self.set_beam_times
        if times is None:
            test = self.beam_order_test
            times = STATED if test is None or test.times is None else test.times
        return replace(times, centred=not self.states_beam_times)

    @cached_property
    def beam_order_test(self) -> BeamOrderTest | None:
        """Comparison of times of the beams; None if the recording has no scans."""
        if not self.has_scans:
            return None
        from ..timing.beam_order import decide_beam_order

        return decide_beam_order(self._turns)

    @cached_property
    def gyroscope_scale(self) -> GyroscopeScale | None:
        """Scale of the rates of a gyroscope; None if the recording has none, or does not determine it."""
        if not self._may_have_gyroscope():
            return None
        from ..timing.gyroscope_scale import estimate_gyroscope_scale

        return estimate_gyroscope_scale(self._turns)

    @cached_property
    def odometry_turns(self) -> OdometryTurns | None:
        """Comparison of the turns of odometry with those of the scans, not mirrored; None if they do not show any."""
        from ..timing.upside_down import compare_odometry_turns

        return compare_odometry_turns(self._turns_not_mirrored)

    @cached_property
    def reason_to_mirror(self) -> str | None:
        """Why scans are mirrored when they are read, as text; None if they are not.

        They are if no mount states whether the lidar is upside down, and odometry shows that it is.
        """
        if self._turns_not_mirrored.mount is not None or self.odometry_turns is None:
            return None
        return self.odometry_turns.reason_to_mirror()

    @property
    def has_scans(self) -> bool:
        """True if the recording contains a scan."""
        return self._turns_as_recorded.scans > 0

    @property
    def states_mount(self) -> bool:
        """True if the first scan states the mount of the lidar on the robot."""
        return self._turns_as_recorded.mount is not None

    def check_scans(self) -> None:
        """Raise RecordingError, which says what is there instead, if the recording has no scan or most are useless."""
        if not self.has_scans or self._lost_scans:
            raise RecordingError(self.path, None, self._lost_scans or self._reason_without_scans())

    @property
    def has_odometry(self) -> bool:
        """True if the recording contains odometry."""
        return len(self._turns.odometry) > 0

    @cached_property
    def odometry_never_moves(self) -> bool:
        """True if odometry has one pose throughout, though the scans show that the robot moves."""
        path = np.column_stack([self._turns.positions, self._turns.odometry[:, 1]])
        if not len(path) or np.any(np.ptp(path, axis=0) > 0.0):
            return False
        frozen = FrozenOdometryDetector()
        for message in self._survey_messages():
            frozen.add(message)
        frozen.finish()
        return bool(frozen.found)

    @cached_property
    def doubt_of_odometry_unit(self) -> str | None:
        """What is wrong with the speed of odometry, as one line of text, if its unit cannot be metres."""
        return OdometrySpeed.of_path(self._turns.odometry[:, 0], self._turns.positions).describe()

    @cached_property
    def doubt_of_odometry_turns(self) -> str | None:
        """What is wrong with the turns of odometry, as one line of text, if it does not measure those of the robot."""
        return None if self.odometry_turns is None else self.odometry_turns.reason_to_ignore()

    @cached_property
    def delay(self) -> Delay | None:
        """Delay of the lidar's stamps against odometry's; None if the recording does not determine it."""
        from ..timing.delay import estimate_delay

        turns = self._turns
        return estimate_delay(turns, self.beam_times) if self.times_known else None

    @cached_property
    def mount_heading(self) -> MountHeading | None:
        """Heading of the lidar on the robot, from its motions; None if the recording does not determine it."""
        from ..timing.mount_heading import estimate_mount_heading

        return estimate_mount_heading(self._turns)

    @property
    def floor(self) -> Floor | None:
        """The floor that the lidar sees, as it is not level; None if the recording shows none.

        None also if odometry does not measure the turns of the robot, by which the floor is distinguished from walls.
        """
        return None if self.doubt_of_odometry_turns is not None else self._turns.floor

    @property
    def own_returns(self) -> OwnReturns | None:
        """Returns from the robot itself, in scans as recorded; None if there are none, or the recording shows none."""
        return self._turns_as_recorded.own_returns

    @cached_property
    def interlacing(self) -> Interlacing | None:
        """Parts of interlaced scans that are stamped late against each other; None if there are none."""
        from ..timing.interlacing import find_interlacing

        return find_interlacing(self._turns_as_recorded)

    @cached_property
    def _turns(self) -> Turns:
        """What is known of the whole recording before it is read: collected once, as that takes as long as reading."""
        from ..timing.turns import Turns

        if self.reason_to_mirror is None:
            return self._turns_not_mirrored
        return Turns(self._mirrored(self._corrected(self._survey_messages())))

    @cached_property
    def _turns_not_mirrored(self) -> Turns:
        """Turns of the drive by scans without returns from the robot itself, stamped alike, which are not mirrored."""
        from ..timing.turns import Turns

        if self.own_returns is None and self.interlacing is None:
            return self._turns_as_recorded
        return Turns(self._corrected(self._survey_messages()))

    @cached_property
    def _turns_as_recorded(self) -> Turns:
        """Turns of the drive by scans as they are recorded, which may show the robot itself."""
        from ..timing.turns import Turns

        return Turns(self._survey_messages())

    def _corrected(self, messages: Iterable[Message]) -> Iterator[Message]:
        """Yield messages without returns from the robot itself, and with corrected stamps of interlaced parts."""
        own, interlacing = self.own_returns, self.interlacing
        if own is not None:
            messages = (own.left_out(message) if isinstance(message, Scan) else message for message in messages)
        if interlacing is not None:
            stamped = (interlacing.of(message) if isinstance(message, Scan) else message for message in messages)
            messages = sort_within(stamped, interlacing.earlier)
        return iter(messages)

    @staticmethod
    def _mirrored(messages: Iterable[Message]) -> Iterator[Message]:
        """Yield messages with mirrored scans."""
        return (mirrored(message) if isinstance(message, Scan) else message for message in messages)

    def _survey_messages(self) -> Iterator[Message]:
        """Yield the messages as they are recorded, without an entry in the report.

        If all of them have been yielded, the next iteration does not read them again, up to MAX_KEPT_BYTES.
        """
        report, self.report = self.report, SourceReport()
        kept, size = deque[Message](), 0
        try:
            for message in self._messages():
                if isinstance(message, Scan):
                    size += message.ranges.nbytes + message.angles.nbytes + message.time_offsets.nbytes
                kept.append(message)
                if size > MAX_KEPT_BYTES:
                    kept.clear()
                yield message
            self._survey = _Survey(kept, self.report) if size <= MAX_KEPT_BYTES else None
        finally:
            self.report = report

    def _first_or_new_messages(self) -> Iterator[Message]:
        """Return the messages of the survey, if there is one that was not used yet, or read them."""
        survey, self._survey = self._survey, None
        if survey is None:
            self.report = SourceReport()
            return self._messages()
        self.report = survey.report
        return _taken_from(survey.messages)

    @abstractmethod
    def _messages(self) -> Iterator[Message]:
        """Yield the messages as they are recorded, and report on them."""

    def _may_have_gyroscope(self) -> bool:
        """Return false if the recording certainly has no rates of a gyroscope, which a subclass knows."""
        return False

    def _reason_without_scans(self) -> str:
        """Return the error text for a recording without a scan."""
        return "contains no laser scan, so there is nothing to map"


def _taken_from(messages: deque[Message]) -> Iterator[Message]:
    """Yield messages and drop each of them, so that memory is free for what is made of them."""
    while messages:
        yield messages.popleft()
