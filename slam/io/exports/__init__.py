"""Maps for other programs, made of what a run left behind; one file a format.

Formats of the map as it is (`write_geojson`, `write_svg`, `write_dxf`) need the session only. Those made of the scans
(`write_pgm`, `write_ply`) place them where the finished path says they were taken, so they need the recording as well.
"""

from __future__ import annotations

from .dxf import write_dxf
from .geojson import write_geojson
from .occupancy import Occupancy, OccupancyGrid, Thresholds
from .pgm import write_pgm, write_pgm_yaml
from .placed import PlacedScan, placed_scans
from .ply import write_ply
from .session import Session, open_recording, read_session
from .svg import write_svg

__all__ = [
    "Occupancy",
    "OccupancyGrid",
    "PlacedScan",
    "Session",
    "Thresholds",
    "open_recording",
    "placed_scans",
    "read_session",
    "write_dxf",
    "write_geojson",
    "write_pgm",
    "write_pgm_yaml",
    "write_ply",
    "write_svg",
]
