"""The map as GeoJSON: walls and corners with their uncertainties, and the path.

Coordinates are metres in the map, x before y, and not the degrees of RFC 7946: a building that was driven through does
not know where on Earth it stands. The collection says so in its members `frame` and `units`.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...events import MapCorners, MapWalls
from ..tum import Floats
from .session import Session
from .thinning import thinned


def write_geojson(path: Path, session: Session) -> None:
    """Write the map; a feature a line, so that a person can scan it."""
    features = [*_walls(session.lines), *_corners(session.corners), _path(session.trajectory.poses)]
    rows = ",\n".join(json.dumps(feature, allow_nan=False) for feature in features)
    head = '"type": "FeatureCollection", "frame": "map", "units": "m"'
    path.write_text(f'{{{head}, "features": [\n{rows}\n]}}\n', encoding="utf-8", newline="\n")


def _walls(lines: MapWalls) -> list[dict[str, Any]]:
    """Each wall as the pieces of it that were seen; `heading` runs along it, and it is seen from the left of that."""
    points, wall = lines.piece_points()
    return [
        _feature(
            "MultiLineString",
            _rounded(points[wall == k]),
            kind="wall",
            identity=int(lines.identity[k]),
            observations=int(lines.observations[k]),
            heading=round(float(lines.frame[k, 2]), 6),
            sigma_offset=_sigma(lines.covariance[k, 0, 0]),
            sigma_heading=_sigma(lines.covariance[k, 1, 1]),
        )
        for k in range(len(lines))
    ]


def _corners(corners: MapCorners) -> list[dict[str, Any]]:
    return [
        _feature(
            "Point",
            _rounded(corners.position[k]),
            kind="corner",
            identity=int(corners.identity[k]),
            observations=int(corners.observations[k]),
            walls=corners.lines[k].tolist(),
            sigma_x=_sigma(corners.covariance[k, 0, 0]),
            sigma_y=_sigma(corners.covariance[k, 1, 1]),
        )
        for k in range(len(corners))
    ]


def _path(poses: Floats) -> dict[str, Any]:
    kept = _rounded(poses[thinned(poses), :2])
    return _feature("LineString", kept if len(kept) > 1 else kept * 2, kind="path")


def _feature(shape: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    geometry = {"type": shape, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _rounded(points: Floats) -> Any:
    """Micrometres; adding zero turns -0.0 into 0.0."""
    return (np.round(points, 6) + 0.0).tolist()


def _sigma(variance: NDArray[np.float64]) -> float | None:
    """A standard deviation of three digits; None where the variance is not known."""
    return float(f"{math.sqrt(variance):.3g}") if np.isfinite(variance) else None
