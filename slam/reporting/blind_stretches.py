"""Message about the stretches of a drive on which the scans show nothing that can be matched."""

from __future__ import annotations

from drivers.gaps import MIN_GAP

from ..events import Notice


class BlindStretches:
    """Stretches of scans in a row that show nothing, as the lidar is covered or everything is out of its range.

    As in a gap in the scans, it is not seen what the robot does: it may be carried meanwhile.
    """

    def __init__(self) -> None:
        self._count = 0
        self._first: float | None = None  # stamp of the first scan of the present stretch, seconds
        self._last = 0.0  # stamp of its last scan
        self._longest = 0.0, 0.0  # seconds, and the stamp of the first scan

    def add(self, stamp: float, *, blind: bool) -> None:
        """Add the next scan with its stamp (seconds); `blind` is true if it shows nothing."""
        if not blind:
            self._end()
        elif self._first is None:
            self._first = self._last = stamp
        else:
            self._last = stamp

    def summary(self) -> Notice | None:
        """Return the warning at the end of a run, with the stamp of the longest stretch; None if all are short."""
        self._end()
        if not self._count:
            return None
        seconds, stamp = self._longest
        several = f", the longest of {self._count} times" if self._count > 1 else ""
        reason = "the lidar was covered, or everything was out of its range"
        return Notice(stamp, f"the scans showed nothing for {seconds:.1f} s{several}: {reason}")

    def _end(self) -> None:
        """End the present stretch, if there is one."""
        if self._first is not None and self._last - self._first > MIN_GAP:
            self._count += 1
            self._longest = max(self._longest, (self._last - self._first, self._first))
        self._first = None
