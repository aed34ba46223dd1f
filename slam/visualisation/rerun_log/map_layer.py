"""Draw the map: all walls and all corners, each as one batch."""

from __future__ import annotations

import math

import rerun as rr

from ...io.exports.svg_drawing import MAX_ELLIPSE
from ...mapping.map_features import MapCorners, MapWalls
from . import colours
from .rrd_writer import RrdWriter
from .shapes import SIGMAS, Height, ellipses, largest_sigmas, to_3d, wall_bands

MIN_OBSERVATIONS = 3  # keyframes; walls observed less often are drawn dimmer

_WALL_WIDTH, _BAND_WIDTH, _CORNER_SIZE = rr.Radius.ui_points(1.3), rr.Radius.ui_points(0.5), rr.Radius.ui_points(2.2)
_OUTLINE = rr.Radius.ui_points(0.4)


FILLED = rr.components.FillMode.TransparentFillMajorWireframe  # what lies below remains visible


class MapLayer:
    """Walls with 3-sigma bands and corners with 3-sigma ellipses, below `world/map`."""

    def __init__(self, writer: RrdWriter) -> None:
        self._writer = writer
        walls = rr.LineStrips3D.from_fields(radii=_WALL_WIDTH, show_labels=False)
        bands = rr.LineStrips3D.from_fields(radii=_BAND_WIDTH, colors=colours.WALL_SIGMA)
        corners = rr.Points3D.from_fields(radii=_CORNER_SIZE, colors=colours.CORNER, show_labels=False)
        spread = rr.Ellipsoids3D.from_fields(
            colors=colours.CORNER, line_radii=_OUTLINE, fill_mode=FILLED, show_labels=False
        )
        for name, style in (("walls", walls), ("wall_sigma", bands), ("corners", corners), ("corner_sigma", spread)):
            writer.log_static(f"world/map/{name}", style)

    def log(self, walls: MapWalls, corners: MapCorners) -> None:
        """Log the whole map at the current time."""
        self._log_walls(walls)
        self._log_corners(corners)

    def _log_walls(self, walls: MapWalls) -> None:
        """Log the walls with labels like `L12 n=7`, and the bands of those with a covariance."""
        ends, wall = walls.piece_points()
        identity, observations = walls.identity[wall], walls.observations[wall]
        labels = [f"L{k} n={n}" for k, n in zip(identity.tolist(), observations.tolist(), strict=True)]
        shades = [colours.WALL if n >= MIN_OBSERVATIONS else colours.WALL_NEW for n in observations.tolist()]
        strips = rr.LineStrips3D.from_fields(strips=to_3d(ends, Height.WALL), colors=shades, labels=labels)
        self._writer.log("world/map/walls", strips)
        bands = rr.LineStrips3D.from_fields(strips=to_3d(wall_bands(walls), Height.SIGMA))
        self._writer.log("world/map/wall_sigma", bands)

    def _log_corners(self, corners: MapCorners) -> None:
        """Log the corners with labels like `C3 n=5 of L1, L4 σ=2 cm`, and the ellipses up to MAX_ELLIPSE."""
        largest = largest_sigmas(corners.covariance)
        sigmas = ["" if math.isnan(sigma) else f" σ={100 * sigma:.0f} cm" for sigma in largest.tolist()]
        rows = zip(
            corners.identity.tolist(), corners.observations.tolist(), corners.walls.tolist(), sigmas, strict=True
        )
        points = rr.Points3D.from_fields(
            positions=to_3d(corners.position.reshape(-1, 2), Height.CORNER),
            labels=[f"C{k} n={n} of L{first}, L{second}{sigma}" for k, n, (first, second), sigma in rows],
        )
        self._writer.log("world/map/corners", points)
        drawn = SIGMAS * largest <= MAX_ELLIPSE
        centres, half_sizes, quaternions = ellipses(corners.position[drawn], corners.covariance[drawn], Height.SIGMA)
        spread = rr.Ellipsoids3D.from_fields(centers=centres, half_sizes=half_sizes, quaternions=quaternions)
        self._writer.log("world/map/corner_sigma", spread)
