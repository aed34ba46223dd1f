"""The map: all walls and corners in a batch each, logged whole."""

from __future__ import annotations

import rerun as rr

from ...events import MapCorners, MapWalls
from . import colours
from .recording import Recording
from .shapes import Layer, ellipses, lift, wall_bands

OFTEN_SEEN = 3  # keyframes; walls seen less often are drawn dimmer

_WALL_WIDTH, _BAND_WIDTH, _CORNER_SIZE = rr.Radius.ui_points(1.3), rr.Radius.ui_points(0.5), rr.Radius.ui_points(2.2)
_OUTLINE = rr.Radius.ui_points(0.7)


def prepare(recording: Recording) -> None:
    """Log how the map looks, whatever it will hold."""
    recording.keep("world/map/walls", rr.LineStrips3D.from_fields(radii=_WALL_WIDTH, show_labels=False))
    recording.keep("world/map/wall_sigma", rr.LineStrips3D.from_fields(radii=_BAND_WIDTH, colors=colours.WALL_SIGMA))
    corners = rr.Points3D.from_fields(radii=_CORNER_SIZE, colors=colours.CORNER, show_labels=False)
    recording.keep("world/map/corners", corners)
    outline = rr.components.FillMode.MajorWireframe  # what is filled hides what matters
    spread = rr.Ellipsoids3D.from_fields(
        colors=colours.CORNER, line_radii=_OUTLINE, fill_mode=outline, show_labels=False
    )
    recording.keep("world/map/corner_sigma", spread)


def log_lines(recording: Recording, lines: MapWalls) -> None:
    """Log the walls, labelled like `L12 n=7`, and their 3-sigma bands where the covariance is known."""
    ends, wall = lines.piece_points()
    identity, observations = lines.identity[wall], lines.observations[wall]
    labels = [f"L{k} n={n}" for k, n in zip(identity.tolist(), observations.tolist(), strict=True)]
    often = observations >= OFTEN_SEEN
    shades = [colours.WALL if seen else colours.WALL_FRESH for seen in often.tolist()]
    walls = rr.LineStrips3D.from_fields(strips=lift(ends, Layer.WALL), colors=shades, labels=labels)
    recording.log("world/map/walls", walls)
    bands = rr.LineStrips3D.from_fields(strips=lift(wall_bands(lines), Layer.SIGMA))
    recording.log("world/map/wall_sigma", bands)


def log_corners(recording: Recording, corners: MapCorners) -> None:
    """Log the corners, labelled like `C3 n=5 of L1, L4`, and their 3-sigma ellipses where the covariance is known."""
    rows = zip(corners.identity.tolist(), corners.observations.tolist(), corners.lines.tolist(), strict=True)
    points = rr.Points3D.from_fields(
        positions=lift(corners.position.reshape(-1, 2), Layer.CORNER),
        labels=[f"C{k} n={n} of L{first}, L{second}" for k, n, (first, second) in rows],
    )
    recording.log("world/map/corners", points)
    centres, half_sizes, quaternions = ellipses(corners.position, corners.covariance, Layer.SIGMA)
    spread = rr.Ellipsoids3D.from_fields(centers=centres, half_sizes=half_sizes, quaternions=quaternions)
    recording.log("world/map/corner_sigma", spread)
