"""Timelines of the log."""

from __future__ import annotations

import numpy as np
import rerun as rr

from drivers.timestamps import MIN_EPOCH_STAMP

SENSOR_TIME, KEYFRAME = "sensor_time", "keyframe"
CANDIDATE, CLOSURE = "candidate", "closure"
"""Timelines with one step per loop decision and per correction of the map."""


def is_date(nanoseconds: int) -> bool:
    """Return True if a sensor time is one since 1970, rather than since a device was switched on."""
    return nanoseconds > 1e9 * MIN_EPOCH_STAMP


def time_column(timeline: str, values: list[int], *, dates: bool) -> rr.TimeColumn:
    """Return times as a column: nanoseconds of SENSOR_TIME, as `dates` or durations; numbers of other timelines."""
    if timeline != SENSOR_TIME:
        return rr.TimeColumn(timeline, sequence=values)
    if dates:
        return rr.TimeColumn(timeline, timestamp=np.array(values).astype("datetime64[ns]"))
    return rr.TimeColumn(timeline, duration=np.array(values).astype("timedelta64[ns]"))
