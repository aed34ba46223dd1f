"""Write the map as GeoJSON: walls, corners, rooms, openings and the driven path, with the confidence map.

Coordinates are metres in the map's frame, x before y, not the degrees of RFC 7946: the map's position on Earth is
unknown. The collection's members `frame` and `units` state this.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry.segments import Floats
from ...mapping.map_features import MapCorners, MapWalls
from ...measuring.measured_map import NOTHING_MEASURED, MeasuredMap
from ...measuring.openings import Opening
from ...measuring.rooms import Room
from ..run_results import RunResults
from .confidence import CLASS_LIMITS, wall_stretches, weak_places
from .path_thinning import thin_path


def write_geojson(path: Path, results: RunResults, measured: MeasuredMap = NOTHING_MEASURED) -> None:
    """Write the map, and the rooms and openings of a measured map, with one feature per line, for readability."""
    features = [
        *_walls(results.walls),
        *_corners(results.corners),
        *(_path(drive.poses) for drive in results.drives()),
    ]
    features += [*_confidence(results), *_weak_places(results)]
    features += [*map(_room, measured.rooms), *map(_opening, measured.openings)]
    rows = ",\n".join(json.dumps(feature, allow_nan=False) for feature in features)
    head = '"type": "FeatureCollection", "frame": "map", "units": "m"'
    path.write_text(f'{{{head}, "features": [\n{rows}\n]}}\n', encoding="utf-8", newline="\n")


def _walls(walls: MapWalls) -> list[dict[str, Any]]:
    """Return a feature for each wall with its observed pieces; `heading` is along it, seen from its left."""
    points, wall = walls.piece_points()
    return [
        _feature(
            "MultiLineString",
            _rounded(points[wall == k]),
            kind="wall",
            identity=int(walls.identity[k]),
            observations=int(walls.observations[k]),
            heading=round(float(walls.frame[k, 2]), 6),
            sigma_offset=_sigma(walls.covariance[k, 0, 0]),
            sigma_heading=_sigma(walls.covariance[k, 1, 1]),
        )
        for k in range(len(walls))
    ]


def _corners(corners: MapCorners) -> list[dict[str, Any]]:
    return [
        _feature(
            "Point",
            _rounded(corners.position[k]),
            kind="corner",
            identity=int(corners.identity[k]),
            observations=int(corners.observations[k]),
            walls=corners.walls[k].tolist(),
            sigma_x=_sigma(corners.covariance[k, 0, 0]),
            sigma_y=_sigma(corners.covariance[k, 1, 1]),
        )
        for k in range(len(corners))
    ]


def _path(poses: Floats) -> dict[str, Any]:
    points = _rounded(poses[thin_path(poses), :2])
    return _feature("LineString", points if len(points) > 1 else points * 2, kind="path")


def _room(room: Room) -> dict[str, Any]:
    """Return a polygon, whose holes are the islands."""
    rings = [np.concatenate([part.vertices, part.vertices[:1]]) for part in (room.outline, *room.islands)]
    return _feature(
        "Polygon",
        [_rounded(ring) for ring in rings],
        kind="room",
        name=room.name,
        area=round(room.area, 4),
        sigma_area=_rounded_sigma(room.area_sigma),
        perimeter=round(room.perimeter, 4),
        sigma_perimeter=_rounded_sigma(room.perimeter_sigma),
        observed=round(room.observed, 3),
    )


def _opening(opening: Opening) -> dict[str, Any]:
    return _feature(
        "LineString",
        _rounded(opening.ends),
        kind=opening.kind.value,
        name=opening.name,
        width=round(opening.width, 2),
        walls=list(opening.walls),
        rooms=list(opening.rooms),
        driven=opening.driven,
    )


def _confidence(results: RunResults) -> list[dict[str, Any]]:
    """Return a feature for each stretch of a wall with one class of uncertainty."""
    return [
        _feature(
            "LineString",
            _rounded(stretch.points),
            kind="confidence",
            wall=stretch.identity,
            sigma=_sigma(np.square(stretch.sigma)),
            under=CLASS_LIMITS[stretch.level] if stretch.level < len(CLASS_LIMITS) else None,
        )
        for stretch in wall_stretches(results.walls)
    ]


def _weak_places(results: RunResults) -> list[dict[str, Any]]:
    """Return a feature for each weak place: a point, or a line to the place that a drive should lead to."""
    features = []
    for place in weak_places(results):
        here = _rounded(place.position)
        coordinates = here if place.target is None else [here, _rounded(place.target)]
        features.append(
            _feature(
                "Point" if place.target is None else "LineString",
                coordinates,
                kind="weak_place",
                of=str(place.kind),
                sigma=_sigma(np.square(place.sigma)),
                text=place.text,
                drive=place.drive,
            )
        )
    return features


def _feature(geometry_type: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    geometry = {"type": geometry_type, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _rounded(points: Floats) -> Any:
    """Return points rounded to micrometres; adding zero turns -0.0 into 0.0."""
    return (np.round(points, 6) + 0.0).tolist()


def _sigma(variance: float | NDArray[np.float64]) -> float | None:
    """Return the standard deviation with three significant digits; None if the variance is unknown."""
    return _rounded_sigma(math.sqrt(variance)) if np.isfinite(variance) else None


def _rounded_sigma(sigma: float) -> float:
    return float(f"{sigma:.3g}")
