"""Read the lines of a GeoJSON file, in metres or another unit of length, not in degrees."""

from __future__ import annotations

import reprlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ...errors import MapError
from ...geometry.segments import Floats
from ..json_files import read_json
from .drawing import Drawing, polyline
from .units import METRES, Unit


def read_geojson(path: Path) -> Drawing:
    """Read a FeatureCollection, a Feature or a geometry: the lines of line strings and the outlines of polygons.

    In files of `wclm map`, only the walls, which are seen from the left. Raises MapError.
    """
    data = read_json(path)
    if not isinstance(data, dict) or not isinstance(data.get("type"), str):
        raise MapError(f"{path}: is not GeoJSON: it has no type")
    own = data.get("frame") == "map"
    left_out: Counter[str] = Counter()
    lines: list[Floats] = []
    for geometry, properties in _geometries(data):
        if own and properties.get("kind") != "wall":
            continue
        try:
            lines += _lines_of(geometry, left_out)
        except (TypeError, ValueError, KeyError, IndexError) as error:
            raise MapError(f"{path}: is not valid GeoJSON: a {geometry.get('type')} has wrong coordinates") from error
    unit = data.get("units")
    if unit is not None and not (isinstance(unit, str) and unit in METRES):
        raise MapError(f"{path}: units: {reprlib.repr(unit)} is none of {', '.join(METRES)}")
    return Drawing(lines, own, None if unit is None else METRES[Unit(unit)], dict(left_out))


def _geometries(data: dict[str, Any]) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Yield all geometries with the properties of their features."""
    match data.get("type"):
        case "FeatureCollection":
            features = data.get("features")
            for feature in features if isinstance(features, list) else ():
                if isinstance(feature, dict):
                    yield from _geometries(feature)
        case "Feature":
            geometry, properties = data.get("geometry"), data.get("properties")
            if isinstance(geometry, dict):
                yield geometry, properties if isinstance(properties, dict) else {}
        case _:
            yield data, {}


def _lines_of(geometry: dict[str, Any], left_out: Counter[str]) -> Iterator[Floats]:
    """Yield the polylines of a geometry; count those that have none."""
    kind = geometry.get("type")
    match kind:
        case "LineString":
            yield polyline(geometry["coordinates"])
        case "MultiLineString" | "Polygon":
            yield from map(polyline, geometry["coordinates"])
        case "MultiPolygon":
            for rings in geometry["coordinates"]:
                yield from map(polyline, rings)
        case "GeometryCollection":
            for part in geometry["geometries"]:
                yield from _lines_of(part, left_out)
        case _:
            left_out[str(kind)] += 1
