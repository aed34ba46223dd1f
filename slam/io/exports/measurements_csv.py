"""Write measurements as a table for spreadsheets."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from io import StringIO

from ...measuring.measurement import Measurement

COLUMNS = ("room", "kind", "walls", "value", "sigma", "unit", "x1", "y1", "x2", "y2")


def measurements_csv(measurements: Iterable[Measurement]) -> str:
    """Return the table: one line per measurement below the names of the columns.

    `walls` are landmark ids between spaces; `value` and its standard deviation `sigma` are in `unit`: m, rad or m2;
    x1, y1 and x2, y2 are the points between which it was measured, metres in the map.
    """
    text = StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for one in measurements:
        places = [f"{value:z.4f}" for value in one.ends.ravel().tolist()]
        room = "" if one.room is None else one.room
        walls = " ".join(str(wall) for wall in one.walls)
        table.writerow([room, one.kind, walls, f"{one.value:.5f}", f"{one.sigma:.2g}", one.unit, *places])
    return text.getvalue()
