"""Read the straight lines of an SVG drawing: line, polyline, polygon, rect, and paths of straight lines."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ...errors import MapError, first_line
from ...geometry.segments import Floats
from .drawing import Drawing, polyline

OWN_GROUP = "walls"
"""Class of the group with the walls in drawings of `wclm map`, whose unit is a metre."""
HIDDEN = ("defs", "clipPath", "mask", "pattern", "marker", "symbol")
"""Elements whose content is not drawn where it stands."""
CURVES = ("circle", "ellipse")
TRANSFORM = re.compile(r"(matrix|translate|scale|rotate|skewX|skewY)\s*\(([^)]*)\)")
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
TOKEN = re.compile(rf"[A-Za-z]|{NUMBER.pattern}")
ARGUMENTS = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}
"""Numbers that each command of a path takes."""


def read_svg(path: Path) -> Drawing:
    """Read a drawing; the y axis, which points down in SVG, is reversed. Raises MapError."""
    try:
        root = ElementTree.parse(path).getroot()
    except OSError as error:
        raise MapError(f"{path}: {error.strerror or error}") from error
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise MapError(f"{path}: is not XML: {first_line(error)}") from error
    if _name(root) != "svg":
        raise MapError(f"{path}: is not SVG: its root is {_name(root)}")
    walls = next((group for group in root.iter() if group.get("class") == OWN_GROUP), None)
    left_out: Counter[str] = Counter()
    try:
        lines = list(_lines_below(root if walls is None else walls, np.eye(3), left_out))
    except (ValueError, IndexError) as error:
        raise MapError(f"{path}: is not valid SVG: {first_line(error)}") from error
    upward = np.array([1.0, -1.0])
    return Drawing([line * upward for line in lines], walls is not None, None if walls is None else 1.0, dict(left_out))


def _name(element: ElementTree.Element) -> str:
    """Return the name of an element without its namespace."""
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def _lines_below(element: ElementTree.Element, outer: Floats, left_out: Counter[str]) -> Iterator[Floats]:
    """Yield the polylines of an element and of those in it; `outer` (3, 3) is the transformation around it."""
    name = _name(element)
    if name in HIDDEN or element.get("display") == "none":
        return
    inner = outer @ _transformation(element.get("transform", ""))
    for line in _lines_of(element, name, left_out):
        yield line @ inner[:2, :2].T + inner[:2, 2]
    for child in element:
        yield from _lines_below(child, inner, left_out)


def _lines_of(element: ElementTree.Element, name: str, left_out: Counter[str]) -> Iterator[Floats]:
    """Yield the polylines of one element in its own coordinates."""

    def value(key: str) -> float:
        found = NUMBER.match(element.get(key, "0").strip())
        if found is None:
            raise ValueError(f"{name}: {key} is no number")
        return float(found.group())

    match name:
        case "line":
            yield polyline([(value("x1"), value("y1")), (value("x2"), value("y2"))])
        case "polyline" | "polygon":
            numbers = [float(text) for text in NUMBER.findall(element.get("points", ""))]
            yield polyline(zip(numbers[::2], numbers[1::2], strict=True), closed=name == "polygon")
        case "rect":
            x, y, width, height = value("x"), value("y"), value("width"), value("height")
            corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
            yield polyline(corners, closed=True)
        case "path":
            yield from _lines_of_path(element.get("d", ""), left_out)
        case _ if name in CURVES:
            left_out[name] += 1


def _lines_of_path(data: str, left_out: Counter[str]) -> Iterator[Floats]:
    """Yield the polylines of the straight parts of a path; curves interrupt them."""
    tokens = TOKEN.findall(data)
    here, start, points = np.zeros(2), np.zeros(2), list[Floats]()
    command, position = "", 0
    while position < len(tokens):
        if tokens[position].isalpha():
            command, position = tokens[position], position + 1
        kind = command.upper()
        if kind not in ARGUMENTS:
            raise ValueError(f"path: unknown command {command or tokens[position]}")
        count = ARGUMENTS[kind]
        numbers = np.array([float(text) for text in tokens[position : position + count]])
        if len(numbers) < count or (count == 0 and position < len(tokens) and not tokens[position].isalpha()):
            raise ValueError(f"path: {command} has too few or too many numbers")
        position += count
        before, here = here, start if kind == "Z" else _end_of(kind, numbers, here, relative=command.islower())
        if kind in "LHVZ":
            points = [*(points or [before]), here]
            continue
        yield polyline([tuple(point) for point in points])
        points = []
        if kind == "M":
            start, command = here, "l" if command == "m" else "L"
        else:
            left_out["curves of paths"] += 1
    yield polyline([tuple(point) for point in points])


def _end_of(kind: str, numbers: Floats, here: Floats, *, relative: bool) -> Floats:
    """Return the point (2,) at which a command of a path ends."""
    origin = here if relative else np.zeros(2)
    if kind == "H":
        return np.array([origin[0] + numbers[0], here[1]])
    if kind == "V":
        return np.array([here[0], origin[1] + numbers[0]])
    return np.asarray(origin + numbers[-2:])


def _transformation(text: str) -> Floats:
    """Return the matrix (3, 3) of a transform attribute."""
    result = np.eye(3)
    for name, content in TRANSFORM.findall(text):
        result = result @ _matrix(name, [float(number) for number in NUMBER.findall(content)])
    return result


def _matrix(name: str, numbers: list[float]) -> Floats:
    """Return the matrix (3, 3) of one transformation."""
    match name, numbers:
        case "matrix", [a, b, c, d, e, f]:
            return np.array([[a, c, e], [b, d, f], [0.0, 0.0, 1.0]])
        case "translate", [x, *rest]:
            return np.array([[1.0, 0.0, x], [0.0, 1.0, rest[0] if rest else 0.0], [0.0, 0.0, 1.0]])
        case "scale", [x, *rest]:
            return np.diag([x, rest[0] if rest else x, 1.0])
        case "rotate", [angle, *centre] if len(centre) in (0, 2):
            c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
            x, y = centre or (0.0, 0.0)
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            return np.asarray(_matrix("translate", [x, y]) @ turn @ _matrix("translate", [-x, -y]))
        case "skewX", [angle]:
            return np.array([[1.0, np.tan(np.radians(angle)), 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        case "skewY", [angle]:
            return np.array([[1.0, 0.0, 0.0], [np.tan(np.radians(angle)), 1.0, 0.0], [0.0, 0.0, 1.0]])
    raise ValueError(f"transform: {name} has a wrong number of values")
