"""Export maps to other programs' formats, one module per format.

GeoJSON, SVG and DXF are made from the results of a run alone. PGM and PLY are made from its scans, placed on the final
trajectory, and need the recording as well; without one they are made from the points that the session keeps.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .dxf import write_dxf
    from .geojson import write_geojson
    from .keyframe_points import place_stored_scans
    from .occupancy import Occupancy, OccupancyGrid, Thresholds
    from .pgm import write_pgm, write_pgm_yaml
    from .ply import write_ply
    from .scan_comparison import checked_scans
    from .scan_placement import PlacedScan, place_scans
    from .svg import write_svg

__all__ = [
    "Occupancy",
    "OccupancyGrid",
    "PlacedScan",
    "Thresholds",
    "checked_scans",
    "place_scans",
    "place_stored_scans",
    "write_dxf",
    "write_geojson",
    "write_pgm",
    "write_pgm_yaml",
    "write_ply",
    "write_svg",
]

_MODULES = {
    "Occupancy": "occupancy",
    "OccupancyGrid": "occupancy",
    "PlacedScan": "scan_placement",
    "Thresholds": "occupancy",
    "place_stored_scans": "keyframe_points",
    "place_scans": "scan_placement",
    "checked_scans": "scan_comparison",
    "write_dxf": "dxf",
    "write_geojson": "geojson",
    "write_pgm": "pgm",
    "write_pgm_yaml": "pgm",
    "write_ply": "ply",
    "write_svg": "svg",
}


def __getattr__(name: str) -> Any:
    # Imported on first use: grid maps need numba, whose import takes longer than to write a report page.
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_MODULES[name]}", __name__), name)
