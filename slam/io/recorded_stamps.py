"""Stamps of `trajectory.tum` for recordings whose stamps were restored (see `drivers.recordings.microseconds`).

The estimator and all other results use the restored stamps. Other programs and published relations name a scan by the
stamp that the recording has; so the trajectory is written with that stamp, and it is replaced when a run is read back.
The same holds for stamps that were shifted to follow those of a session, if the path is that of one recording only, as
after localisation.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from ..geometry.segments import Floats

MICROSECONDS = 1e6
"""Per second; stamps in `trajectory.tum` are rounded to microseconds."""


def as_recorded(stamps: Floats, summary: dict[str, Any]) -> Floats:
    """Return the stamps (n,) of a path, seconds, as they are in the recordings that a run's summary lists."""
    replaced = _replaced(stamps, ((read, recorded) for read, recorded in _pairs(summary)))
    shift = _own_shift(summary)
    return np.asarray(replaced - shift) if shift else replaced


def as_read(stamps: Floats, summary: dict[str, Any]) -> Floats:
    """Return the stamps (n,) of the path in `trajectory.tum`, seconds, as they were read: inverse of `as_recorded`."""
    shift = _own_shift(summary)
    shifted = np.asarray(stamps + shift) if shift else stamps
    return _replaced(shifted, ((recorded, read) for read, recorded in _pairs(summary)))


def _own_shift(summary: dict[str, Any]) -> float:
    """Return the seconds that were added to all stamps of the only recording; zero if there are several."""
    recordings = list(summary.get("recordings") or ())
    return float(recordings[0].get("shift", 0.0)) if len(recordings) == 1 else 0.0


def _pairs(summary: dict[str, Any]) -> Iterable[tuple[float, float]]:
    """Yield each restored stamp as read and as recorded, on the clock of the run."""
    for recording in summary.get("recordings") or ():
        shift = float(recording.get("shift", 0.0))
        for read, recorded in (recording.get("recorded_stamps") or {}).items():
            yield float(read) + shift, float(recorded) + shift


def _replaced(stamps: Floats, pairs: Iterable[tuple[float, float]]) -> Floats:
    others = {round(MICROSECONDS * old): new for old, new in pairs}
    if not others:
        return stamps
    return np.array([others.get(round(MICROSECONDS * stamp), stamp) for stamp in stamps.tolist()])
