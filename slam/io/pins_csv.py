"""Read pins from a CSV file: surveyed coordinates of poses and walls, one per line below a header.

Columns: `kind` (pose or wall), `id` (stamp in seconds, or identity of the wall), `x` and `y` (metres), and either
`sigma` (metres, the same in all directions) or `xx`, `xy`, `yy` (square metres); optionally `heading` and
`sigma_heading` (radians).
"""

from __future__ import annotations

import csv
import math
from pathlib import Path

from pydantic import ValidationError

from drivers.validation import first_problem

from ..errors import MapError
from .sessions.corrections import Pin, PinSet

COLUMNS = ("kind", "id", "x", "y", "sigma", "xx", "xy", "yy", "heading", "sigma_heading")
REQUIRED = COLUMNS[:4]
MAX_COORDINATE = 1e5
"""Metres; larger coordinates are those of a national grid, from which an offset must be subtracted."""
MIN_SIGMA = 1e-5
"""Metres; smallest standard deviation."""


def read_pins(path: Path) -> PinSet:
    """Read the pins of a file. Raises MapError naming the file, the line and the problem."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            header = [name.strip() for name in reader.fieldnames or ()]
            reader.fieldnames = header
            _check_header(path, header)
            pins = [_pin(f"{path}:{reader.line_num}", row) for row in reader]
    except OSError as error:
        raise MapError(f"{path}: {error.strerror or error}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise MapError(f"{path}: is not a CSV file: {error}") from error
    if not pins:
        raise MapError(f"{path}: has no pins")
    return PinSet(file=path.name, pins=pins)


def _check_header(path: Path, header: list[str]) -> None:
    if not header:
        raise MapError(f"{path}: is empty")
    missing = [name for name in REQUIRED if name not in header]
    unknown = [name for name in header if name not in COLUMNS]
    if missing:
        raise MapError(f"{path}: has no column {missing[0]}")
    if unknown:
        raise MapError(f"{path}: has the unknown column {unknown[0]}; known are {', '.join(COLUMNS)}")
    if "sigma" not in header and not {"xx", "xy", "yy"} <= set(header):
        raise MapError(f"{path}: has no column sigma, nor the columns xx, xy and yy")


def _pin(place: str, row: dict[str | None, str | None]) -> Pin:
    """Return the pin in a row of the table; `place` is the file and the line."""
    if None in row or None in row.values():
        raise MapError(f"{place}: has another number of columns than the header")
    text = {name: (value or "").strip() for name, value in row.items() if name}
    numbers = {name: _number(place, name, value) for name, value in text.items() if name != "kind" and value}
    for name in REQUIRED[1:]:
        if name not in numbers:
            raise MapError(f"{place}: {name} is missing")
    if text["kind"] == "wall" and (numbers["id"] < 0 or numbers["id"] % 1):
        raise MapError(f"{place}: {text['id']} is no identity of a wall")
    if max(abs(numbers["x"]), abs(numbers["y"])) > MAX_COORDINATE:
        raise MapError(f"{place}: coordinates beyond {MAX_COORDINATE:.0f} m; subtract a common offset")
    if ("heading" in numbers) != ("sigma_heading" in numbers):
        raise MapError(f"{place}: heading and sigma_heading must be stated together")
    sigma = numbers.pop("sigma", None)
    if (sigma is not None) == any(name in numbers for name in ("xx", "xy", "yy")):
        raise MapError(f"{place}: must state either sigma or xx, xy and yy")
    if sigma is not None and not 0.0 <= sigma <= MAX_COORDINATE:
        raise MapError(f"{place}: sigma is not between 0 and {MAX_COORDINATE:.0f} m")
    if sigma is not None:
        numbers |= {"xx": sigma**2, "xy": 0.0, "yy": sigma**2}
    try:
        pin = Pin.model_validate({"kind": text["kind"], **numbers})
    except ValidationError as error:
        raise MapError(f"{place}: {first_problem(error)}") from error
    if min(pin.xx, pin.yy) < MIN_SIGMA**2 or pin.xx * pin.yy - pin.xy * pin.xy < MIN_SIGMA**4:
        raise MapError(f"{place}: is no covariance, or below {1e3 * MIN_SIGMA:g} mm")
    return pin


def _number(place: str, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise MapError(f"{place}: {name} is no number: {text[:40]}")
    return value
