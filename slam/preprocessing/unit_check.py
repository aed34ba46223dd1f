"""Check of the units of messages, as the readers of recordings check them, for a run that cannot look ahead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.messages import Message, Odometry, Scan
from drivers.recordings.no_returns import find_no_return
from drivers.recordings.range_units import FAR, are_metres
from drivers.recordings.stamp_units import MIN_MESSAGES, SAMPLE, UNITS, find_unit

from ..formatting import counted
from ..geometry.segments import Floats


class UnitCheck:
    """Judgement of the first scans of a run by their ranges, and of the first messages by their stamps."""

    def __init__(self) -> None:
        self._scans = 0
        self._readings: list[Floats] | None = []  # of the first scans; None once they are judged
        self._stamped: list[Message] | None = []  # first scans and odometry; None once they are judged
        self._sample = SAMPLE
        self._outside: Scan | None = None  # a scan all of whose ranges are outside of its limits
        self._has_return = self._was_stated = False

    def add(self, message: Message) -> str | None:
        """Process the next message; return what is wrong with the units, as one line of text, the first time only."""
        if not isinstance(message, Scan | Odometry):
            return None
        if self._stamped is not None:
            self._stamped.append(_without_beams(message) if isinstance(message, Scan) else message)
        if isinstance(message, Scan):
            self._add_scan(message)
        enough = self._readings is not None and len(self._readings) >= MIN_MESSAGES
        problem = self._judge_ranges() if enough else None
        if problem is None and self._stamped is not None and len(self._stamped) >= self._sample:
            problem = self._judge_stamps()
        self._was_stated |= problem is not None
        return problem

    def at_end(self) -> str | None:
        """Return what is wrong with the units of a run that has ended, if that was not stated before, else None."""
        if self._was_stated:
            return None
        problem = self._judge_ranges() or self._judge_stamps()
        if problem is None and not self._has_return and (scan := self._outside) is not None:
            limits = f"range_min ({scan.range_min:g}) and range_max ({scan.range_max:g})"
            return f"no range of {counted(self._scans, 'scan')} is between {limits}; all of them must be in metres"
        return problem

    def _add_scan(self, scan: Scan) -> None:
        self._scans += 1
        if self._readings is not None:
            self._readings.append(scan.ranges)
        if not self._has_return:
            given = scan.ranges[np.isfinite(scan.ranges) & (scan.ranges != 0.0)]
            self._has_return = bool(np.any((given >= scan.range_min) & (given < scan.range_max)))
            self._outside = scan if len(given) else self._outside

    def _judge_ranges(self) -> str | None:
        readings, self._readings = self._readings or [], None
        no_return = find_no_return(readings) or np.inf
        if are_metres([one[one < no_return] for one in readings]):
            return None
        return f"nearly all ranges are beyond {FAR:g}: they must be in metres; divide millimetres by 1000"

    def _judge_stamps(self) -> str | None:
        per_second = find_unit(self._stamped or [])
        if per_second is None:
            self._sample *= 2  # the robot has to move for that
            return None
        self._stamped = None
        if per_second == 1.0:
            return None
        unit = UNITS[per_second]
        return (
            f"the stamps are in {unit}, by the speed of the robot: they must be in seconds; divide by {per_second:.0f}"
        )


def _without_beams(scan: Scan) -> Scan:
    """Return a scan of which only the stamp is needed, so that its arrays are not kept."""
    nothing = np.zeros(0)
    return replace(scan, ranges=nothing, angles=nothing, time_offsets=nothing, intensities=None)
