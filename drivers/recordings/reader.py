"""Base class of all readers of recordings: checks the path, reports defects, orders messages by time."""

from __future__ import annotations

import os
from abc import abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

from ..errors import RecordingError
from ..messages import Message, Odometry, Scan
from .copies import without_copies
from .frozen_odometry import FrozenOdometryDetector
from .odometry_speed import OdometrySpeed
from .odometry_spikes import without_spikes
from .stamp_units import in_seconds
from .surveyed_recording import SurveyedRecording
from .time_ordering import FAR, Numbered, order_by_time, sort_within


class RecordingReader(SurveyedRecording):
    """Recording in a file or directory: a `Source` that can be read any number of times.

    A subclass yields the messages in the file's order from `_read` and calls `skip` for entries that it omits. Raises
    RecordingError on construction if the path does not exist, and on iteration if there is no scan and no odometry.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__(path)
        self.name = os.fsencode(self.path.name).decode(errors="replace")  # a name need not be UTF-8
        if not self.path.exists():
            raise RecordingError(self.path, None, "no such file or directory")

    def __iter__(self) -> Iterator[Message]:
        """Yield the messages from the beginning, with non-decreasing stamps."""
        from ..timing.alternating_sources import AlternatingSources

        frozen, speed, sources = FrozenOdometryDetector(), OdometrySpeed(), AlternatingSources()
        times = self.beam_times
        reason, own, gyroscope, floor = self.reason_to_mirror, self.own_returns, self.gyroscope_scale, self.floor
        messages = self._corrected(self._first_or_new_messages())
        report = self.report
        if own is not None:
            self.interpret(f"{own}; they are left out")
        if self.interlacing is not None:
            self.interpret(f"{self.interlacing}; corrected")
        if reason is not None:
            self.interpret(reason)
            messages = self._mirrored(messages)
        if floor is not None:
            self.interpret(f"{floor}; these returns are left out, but it should be mounted level")
            messages = (floor.left_out(message) if isinstance(message, Scan) else message for message in messages)
        if gyroscope is not None:
            report.interpretations += gyroscope.interpretations()
            report.doubts += gyroscope.doubts()
            messages = gyroscope.converted(messages)
        timed = (times.of(message) if isinstance(message, Scan) else message for message in messages)
        for message in sort_within(timed, times.earlier):
            report.messages += 1
            frozen.add(message)
            speed.add(message)
            sources.add(message)
            yield message
        frozen.finish()
        for text in (frozen.describe(), speed.describe(), sources.describe()):
            if text is not None:
                self.doubt(text)

    def select_scans(self, topic: str, cut_height: float | None, cut_thickness: float) -> None:
        """Select the topic of scans or point clouds, empty for the best one, and the layer of clouds (see `HeightCut`).

        Raises RecordingError if a topic is named and the format has none. To be called before the first iteration.
        """
        if topic:
            raise RecordingError(self.path, None, f"has no topics, so none is named {topic}")

    def select_odometry(self, topic: str) -> None:
        """Select the topic of odometry, as `select_scans`. Raises RecordingError if the format has none."""
        raise RecordingError(self.path, None, f"has no topics, so none is named {topic}")

    def _messages(self) -> Iterator[Message]:
        """Yield the messages as they are recorded. Raises RecordingError if there is neither a scan nor odometry."""
        read: Counter[type[Message]] = Counter()
        used: Counter[type[Message]] = Counter()
        try:
            numbered = _counted(self._read(), read)
            ordered = order_by_time(in_seconds(numbered, self), self)
            for message in without_spikes(without_copies(ordered, self), self):
                used[type(message)] += 1
                yield message
        except OSError as error:
            raise self._read_error(error) from error
        first = f" ({self.report.first})" if self.report.first else ""
        if not used[Scan] and not used[Odometry]:
            raise RecordingError(self.path, None, f"{self._empty_reason()}{first}")
        far = min(read[Scan] - used[Scan], self.report.reasons.get(FAR, 0))
        if far > used[Scan]:
            self._lost_scans = f"{far} of {read[Scan]} scans cannot be used: do all sensors stamp in seconds?{first}"
            self.doubt(self._lost_scans)
        elif first and not used[Scan]:
            self._lost_scans = f"{self._reason_without_scans()}{first}"

    def _read_error(self, error: OSError) -> RecordingError:
        return RecordingError(self.path, None, f"cannot be read: {error.strerror or error}")

    def skip(self, line: int | None, reason: str) -> None:
        """Count an omitted entry; `line` is its line or message number."""
        report = self.report
        report.skipped += 1
        report.reasons[reason] = report.reasons.get(reason, 0) + 1
        if report.first is None:
            report.first = str(RecordingError(self.path, line, reason))

    def correct(self, text: str) -> None:
        """Count a correction without loss of a message; `text` is what was wrong and what was done about it."""
        self.report.corrected[text] = self.report.corrected.get(text, 0) + 1

    def interpret(self, text: str) -> None:
        """Report how the content is read where that had to be found out; `text` is one line."""
        self.report.interpretations.append(text)

    def doubt(self, text: str) -> None:
        """Report that something is probably wrong with the content, which is read as it is; `text` is one line."""
        self.report.doubts.append(text)

    @abstractmethod
    def __len__(self) -> int:
        """Return the approximate number of messages; 0 if unknown."""

    @abstractmethod
    def _read(self) -> Iterator[tuple[int, Message]]:
        """Yield (line or message number, 1-based; message with a finite stamp) in the recording's order."""

    def _empty_reason(self) -> str:
        """Return the error text for a recording without a usable message."""
        return "contains no laser scan and no odometry"


def _counted(numbered: Iterable[Numbered], counts: Counter[type[Message]]) -> Iterator[Numbered]:
    """Yield numbered messages and count those of each type."""
    for line, message in numbered:
        counts[type(message)] += 1
        yield line, message
