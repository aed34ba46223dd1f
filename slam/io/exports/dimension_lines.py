"""Measurements as dimension lines of a drawing, and the texts of rooms and openings."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from drivers.immutable import immutable

from ...geometry.segments import Floats
from ...measuring.measurement import Kind, Measurement
from ...measuring.openings import Opening

SIDE_DISTANCE = 0.2
"""Metres between the wall and the dimension line of a room's side, which is inside the room."""
DRAWN_KINDS = (Kind.LENGTH, Kind.WIDTH, Kind.DISTANCE)
"""Kinds that are drawn as lines; areas are texts."""
TEXT_HEIGHT = 0.125
"""Height of the texts, metres: 2.5 mm of paper at 1 : 50, as in working drawings (ISO 3098)."""
AREA_TEXT_HEIGHT = 0.175
"""Height of the texts of rooms, metres: 3.5 mm."""
UPRIGHT = np.radians(5.0)
"""Angle by which a text that is read from the right may lean to the left: walls are never exactly upright."""
TEXT_GAP = 0.3
"""Distance between a text and its line, as a share of the height."""
CHARACTER_WIDTH = 0.8
"""Width of a character of common fonts with the space to the next one, as a share of the height of capital letters."""


@immutable
class DimensionLine:
    """A dimension line.

    measured  (2, 2) points between which the quantity was measured, metres
    line      (2, 2) ends of the dimension line, parallel to it
    text      value and standard deviation in metres
    identity  kind and walls, for a tooltip
    """

    measured: Floats
    line: Floats
    text: str
    identity: str

    @property
    def middle(self) -> Floats:
        """Middle (2,) of the dimension line."""
        return np.asarray(self.line.mean(axis=0))

    @property
    def angle(self) -> float:
        """Direction of the text, radians, so that it is read from below or, if upright, from the right."""
        dx, dy = self.line[1] - self.line[0]
        angle = np.arctan2(dy, dx)
        return float(angle - np.pi * round((angle - UPRIGHT) / np.pi))


def dimension_lines(measurements: Iterable[Measurement]) -> list[DimensionLine]:
    """Return the lines of all measurements that are long enough for their text; lengths are drawn beside the wall."""
    lines = []
    for one in measurements:
        text = format_value(one)
        if one.kind not in DRAWN_KINDS or one.value < CHARACTER_WIDTH * TEXT_HEIGHT * len(text):
            continue
        along = one.ends[1] - one.ends[0]
        left = np.array([-along[1], along[0]]) / np.hypot(*along)
        shift = SIDE_DISTANCE * left if one.kind is Kind.LENGTH else np.zeros(2)
        walls = " and ".join(str(wall) for wall in one.walls)
        lines.append(DimensionLine(one.ends, one.ends + shift, text, f"{one.kind} of {walls}"))
    return lines


def opening_text(opening: Opening) -> tuple[Floats, str, float]:
    """Return place (2,), text and direction (radians, not upside down) of the name and width of a door or passage."""
    line = DimensionLine(opening.ends, opening.ends, f"{opening.name}: {opening.width:.1f} m", opening.name)
    return line.middle, line.text, line.angle


def format_value(measurement: Measurement) -> str:
    """Return a length and its standard deviation in metres, the latter rounded to millimetres, at least one."""
    return f"{measurement.value:.3f} ± {max(round(1e3 * measurement.sigma), 1) / 1e3:.3f}"
