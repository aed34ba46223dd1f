"""Message about the stretches of a drive on which something was wrong."""

from __future__ import annotations

from drivers.gaps import MIN_GAP

from ..events import Notice


class Stretches:
    """Stretches of scans in a row for which the same is wrong."""

    def __init__(self, wrong: str, remark: str) -> None:
        """`wrong` states what is wrong, as a sentence, and `remark` its reason or its consequence."""
        self._wrong, self._remark = wrong, remark
        self._count = 0
        self._first: float | None = None  # stamp of the first scan of the present stretch, seconds
        self._last = 0.0  # stamp of its last scan
        self._longest = 0.0, 0.0  # seconds, and the stamp of the first scan

    def add(self, stamp: float, *, wrong: bool) -> None:
        """Add the next scan with its stamp (seconds); `wrong` is true if it is part of a stretch."""
        if not wrong:
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
        return Notice(stamp, f"{self._wrong} for {seconds:.1f} s{several}: {self._remark}")

    def _end(self) -> None:
        """End the present stretch, if there is one."""
        if self._first is not None and self._last - self._first > MIN_GAP:
            self._count += 1
            self._longest = max(self._longest, (self._last - self._first, self._first))
        self._first = None
