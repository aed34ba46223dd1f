"""Log numbers over time as plotted series; a group is one plot, and a series may begin at any time."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np
import rerun as rr

from .colours import SERIES, Colour
from .rrd_writer import MAX_BATCH_AGE, RrdWriter

MAX_VALUES = 2000  # latest values of a group from which its typical range is computed
SPARSE = ("chi2", "fit")  # groups with few values, each shown as a point as well: a line needs two


class TimeSeries:
    """Groups of numbers, logged as `metrics/<group>`, one series per name, coloured in order of first appearance.

    Names that first appear together share one entity, because all rows of an entity must have the same length.
    """

    def __init__(self, writer: RrdWriter) -> None:
        self._writer = writer
        self._parts: dict[str, list[list[str]]] = {}
        self._largest: dict[str, deque[float]] = {}

    def log(self, group: str, values: Mapping[str, float]) -> None:
        """Log values of one group at the current time; a missing name leaves a gap in its series."""
        parts = self._parts.setdefault(group, [])
        unknown = [name for name in values if not any(name in part for part in parts)]
        if unknown:
            first = sum(len(part) for part in parts)
            parts.append(unknown)
            colours = [SERIES[i % len(SERIES)] for i in range(first, first + len(unknown))]
            series = rr.SeriesLines(names=unknown, colors=colours, widths=[1.5] * len(unknown))
            self._writer.log_static(_entity(group, len(parts) - 1), series)
            if group in SPARSE:
                points = rr.SeriesPoints(names=unknown, colors=colours, marker_sizes=[2.0] * len(unknown))
                self._writer.log_static(_entity(group, len(parts) - 1), points)
        nan = float("nan")
        self._largest.setdefault(group, deque(maxlen=MAX_VALUES)).append(max(values.values(), default=nan))
        for number, names in enumerate(parts):
            if any(name in values for name in names):
                row = [float(values.get(name, nan)) for name in names]
                self._writer.log_batched(_entity(group, number), rr.Scalars, scalars=row, max_age=MAX_BATCH_AGE)

    def mark(self, group: str, name: str, value: float, colour: Colour, marker: rr.components.MarkerShape) -> None:
        """Log a single point in the plot of a group."""
        entity = f"metrics/{group}/{name.replace(' ', '_')}"
        style = rr.SeriesPoints(colors=colour, markers=marker, names=name, marker_sizes=4.0)
        self._writer.log_static(entity, style)
        self._writer.log(entity, rr.Scalars(value))

    def count(self, group: str) -> int:
        """Return the number of rows of a group with a value, of the latest MAX_VALUES."""
        return int(np.isfinite(self._largest.get(group, ())).sum())

    def typical_maximum(self, group: str) -> float | None:
        """Return the 98th percentile of the largest value per row of a group, None without values."""
        largest = np.array(self._largest.get(group, ()))
        largest = largest[np.isfinite(largest)]
        return float(np.percentile(largest, 98)) if len(largest) else None


def _entity(group: str, part: int) -> str:
    return f"metrics/{group}" if part == 0 else f"metrics/{group}/{part}"
