"""The map: all walls and corners in a batch each, logged whole."""

from __future__ import annotations

import rerun as rr

from ..events import MapCorners, MapLines
from . import colours
from .shapes import Layer, ellipses, lift, wall_bands

OFTEN_SEEN = 3  # keyframes; walls seen less often are drawn dimmer

_WALL_WIDTH, _BAND_WIDTH, _CORNER_SIZE = rr.Radius.ui_points(1.3), rr.Radius.ui_points(0.5), rr.Radius.ui_points(2.2)


def log_lines(stream: rr.RecordingStream, lines: MapLines) -> None:
    """Log the walls, labelled like `L12 n=7`, and their 3-sigma bands where the covariance is known."""
    ends, wall = lines.piece_points()
    identity, observations = lines.identity[wall], lines.observations[wall]
    labels = [f"L{k} n={n}" for k, n in zip(identity.tolist(), observations.tolist(), strict=True)]
    often = observations >= OFTEN_SEEN
    walls = rr.LineStrips3D(
        lift(ends, Layer.WALL),
        colors=[colours.WALL if seen else colours.WALL_FRESH for seen in often.tolist()],
        labels=labels,
        show_labels=False,
        radii=_WALL_WIDTH,
    )
    bands = rr.LineStrips3D(lift(wall_bands(lines), Layer.SIGMA), colors=colours.WALL_SIGMA, radii=_BAND_WIDTH)
    stream.log("world/map/walls", walls)
    stream.log("world/map/wall_sigma", bands)


def log_corners(stream: rr.RecordingStream, corners: MapCorners) -> None:
    """Log the corners, labelled like `C3 n=5 of L1, L4`, and their 3-sigma ellipses where the covariance is known."""
    rows = zip(corners.identity.tolist(), corners.observations.tolist(), corners.lines.tolist(), strict=True)
    points = rr.Points3D(
        lift(corners.position.reshape(-1, 2), Layer.CORNER),
        colors=colours.CORNER,
        labels=[f"C{k} n={n} of L{first}, L{second}" for k, n, (first, second) in rows],
        show_labels=False,
        radii=_CORNER_SIZE,
    )
    centres, half_sizes, quaternions = ellipses(corners.position, corners.covariance, Layer.SIGMA)
    uncertainty = rr.Ellipsoids3D(
        centers=centres,
        half_sizes=half_sizes,
        quaternions=quaternions,
        colors=colours.CORNER_SIGMA,
        fill_mode=rr.components.FillMode.Solid,
    )
    stream.log("world/map/corners", points)
    stream.log("world/map/corner_sigma", uncertainty)
