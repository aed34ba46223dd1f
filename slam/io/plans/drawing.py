"""Lines of a drawing in its own unit, before they become a plan in metres."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ...geometry.segments import Floats

DRAWING_PRECISION = 1e-3
"""Standard deviation of the points of a drawing, metres: they are rounded to millimetres."""
MAP_PRECISION = 5e-3
"""The same of the walls of an earlier map, metres: lines fitted to walls that are not quite straight."""


@dataclass(frozen=True, slots=True)
class Drawing:
    """Lines of a drawing, x to the right and y up.

    lines      sequences of points (k, 2), each a polyline, in the drawing's unit
    one_sided  true if walls are seen from the left of their lines only
    unit       metres per unit; None if the file states none
    left_out   numbers of elements that are no straight lines, by what they are
    """

    lines: Sequence[Floats]
    one_sided: bool
    unit: float | None
    left_out: dict[str, int]


def polyline(points: Iterable[Sequence[float]], *, closed: bool = False) -> Floats:
    """Return points as an array (k, 2), with the first one repeated at the end if the line is closed."""
    line = np.array([point[:2] for point in points], dtype=np.float64).reshape(-1, 2)
    return np.concatenate([line, line[:1]]) if closed and len(line) else line


def to_segments(lines: Sequence[Floats]) -> Floats:
    """Return the straight pieces (n, 2, 2) of polylines."""
    pieces = [np.stack([line[:-1], line[1:]], axis=1) for line in lines if len(line) > 1]
    return np.concatenate([np.zeros((0, 2, 2)), *pieces])
