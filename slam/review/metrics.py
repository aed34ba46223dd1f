"""Plotted series. A group is one entity with a value per name; names may turn up late."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import rerun as rr

from .colours import SERIES


class Metrics:
    """Logs groups of numbers as `metrics/<group>`, one series per name, colours in the order in which names turn up."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._names: dict[str, list[str]] = {}
        self._largest: dict[str, list[float]] = {}

    def log(self, group: str, values: Mapping[str, float]) -> None:
        """Log the values of one group at the stream's current time; a name left out is a gap in its series."""
        names = self._names.setdefault(group, [])
        unknown = [name for name in values if name not in names]
        if unknown:
            names += unknown
            colours = [SERIES[i % len(SERIES)] for i in range(len(names))]
            series = rr.SeriesLines(names=names, colors=colours, widths=[1.5] * len(names))
            self._stream.log(f"metrics/{group}", series, static=True)
        nan = float("nan")
        self._largest.setdefault(group, []).append(max(values.values(), default=nan))
        self._stream.log(f"metrics/{group}", rr.Scalars([float(values.get(name, nan)) for name in names]))

    def usual_top(self, group: str) -> float | None:
        """The value below which a plot of the group shows all but a few rows; None where nothing is known."""
        largest = np.array(self._largest.get(group, []))
        largest = largest[np.isfinite(largest)]
        return float(np.percentile(largest, 98)) if len(largest) else None
