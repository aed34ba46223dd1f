"""Plotted series. A group is one plot; names may turn up late."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import rerun as rr

from .colours import SERIES, Colour
from .recording import Recording

KEPT = 2000  # values of a group from which its usual size is told


class Metrics:
    """Logs groups of numbers as `metrics/<group>`, one series per name, colours in the order in which names turn up.

    Names that turn up together are one entity, because an entity's rows must all hold as many numbers.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._parts: dict[str, list[list[str]]] = {}
        self._largest: dict[str, deque[float]] = {}

    def log(self, group: str, values: Mapping[str, float]) -> None:
        """Log the values of one group at the present time; a name left out is a gap in its series."""
        parts = self._parts.setdefault(group, [])
        unknown = [name for name in values if not any(name in part for part in parts)]
        if unknown:
            first = sum(len(part) for part in parts)
            parts.append(unknown)
            colours = [SERIES[i % len(SERIES)] for i in range(first, first + len(unknown))]
            series = rr.SeriesLines(names=unknown, colors=colours, widths=[1.5] * len(unknown))
            self._recording.keep(_entity(group, len(parts) - 1), series)
        nan = float("nan")
        self._largest.setdefault(group, deque(maxlen=KEPT)).append(max(values.values(), default=nan))
        for number, names in enumerate(parts):
            if any(name in values for name in names):
                row = [float(values.get(name, nan)) for name in names]
                self._recording.gather(_entity(group, number), row, _columns)

    def mark(self, group: str, name: str, value: float, colour: Colour, marker: rr.components.MarkerShape) -> None:
        """Log a point over the lines of a group."""
        entity = f"metrics/{group}/{name.replace(' ', '_')}"
        style = rr.SeriesPoints(colors=colour, markers=marker, names=name, marker_sizes=4.0)
        self._recording.keep(entity, style)
        self._recording.log(entity, rr.Scalars(value))

    def usual_top(self, group: str) -> float | None:
        """The value below which a plot shows all but a few of a group's last rows; None where nothing is known."""
        largest = np.array(self._largest.get(group, ()))
        largest = largest[np.isfinite(largest)]
        return float(np.percentile(largest, 98)) if len(largest) else None


def _columns(rows: list[list[float]]) -> Iterable[Any]:
    return rr.Scalars.columns(scalars=np.array(rows).ravel()).partition([len(row) for row in rows])


def _entity(group: str, part: int) -> str:
    return f"metrics/{group}" if part == 0 else f"metrics/{group}/{part}"
