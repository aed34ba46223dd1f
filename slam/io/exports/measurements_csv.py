"""Write measurements and openings as a table for spreadsheets."""

from __future__ import annotations

import csv
from io import StringIO

from ...geometry.segments import Floats
from ...measuring.measured_map import MeasuredMap

COLUMNS = ("room", "kind", "walls", "value", "sigma", "unit", "x1", "y1", "x2", "y2")


def measurements_csv(measured: MeasuredMap) -> str:
    """Return the table: one line per measurement below the names of the columns.

    `walls` are landmark ids between spaces; `value` and its standard deviation `sigma` are in `unit`: m, rad or m2;
    x1, y1 and x2, y2 are the points between which it was measured, metres in the map. The widths of doors and passages
    have no sigma; `room` is the rooms that they lead into.
    """
    text = StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for one in measured.measurements:
        room = "" if one.room is None else one.room
        value = (f"{one.value:.5f}", f"{one.sigma:.2g}", one.unit)
        table.writerow([room, one.kind, _joined(one.walls), *value, *_places(one.ends)])
    for opening in measured.openings:
        value = (f"{opening.width:.2f}", "", "m")
        table.writerow([_joined(opening.rooms), opening.kind, _joined(opening.walls), *value, *_places(opening.ends)])
    return text.getvalue()


def _joined(numbers: tuple[int, ...]) -> str:
    return " ".join(str(number) for number in numbers)


def _places(ends: Floats) -> list[str]:
    return [f"{value:z.4f}" for value in ends.ravel().tolist()]
