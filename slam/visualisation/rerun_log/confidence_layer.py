"""Draw the confidence map of the final map: how well each wall is known by place, and the weak places."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr

from ...checks.weak_places import KeyframePath, WeakPlace, find_weak_places
from ...events import Finished
from ...io.exports.confidence import WallStretch, wall_stretches
from . import colours
from .rrd_writer import RrdWriter
from .shapes import Height, dashed, largest_sigmas, to_3d

_BAND_WIDTH = rr.Radius.ui_points(4.0)
_DRIVE_WIDTH, _PLACE_SIZE = rr.Radius.ui_points(1.2), rr.Radius.ui_points(5.0)
_WEAK = colours.CONFIDENCE[-1]


def log_confidence(writer: RrdWriter, finished: Finished) -> None:
    """Log the confidence map below `world/confidence` at the current time, if the covariances are known."""
    keyframes = finished.keyframes
    if np.isnan(keyframes.covariance).all():
        return
    path = KeyframePath(keyframes.stamps, keyframes.poses[:, :2], largest_sigmas(keyframes.covariance[:, :2, :2]))
    parts: Any = finished.summary.get("parts") or ()
    apart = [int(part["keyframe"]) for part in parts if not part["joined"]]
    _log_walls(writer, wall_stretches(finished.walls))
    _log_weak_places(writer, find_weak_places(finished.walls, path, apart))


def _log_walls(writer: RrdWriter, stretches: Sequence[WallStretch]) -> None:
    """Log bands below the walls, coloured by their standard deviation."""
    bands = rr.LineStrips3D(
        to_3d(np.array([one.points for one in stretches]).reshape(-1, 2, 2), Height.CONFIDENCE),
        colors=[colours.CONFIDENCE[one.level] for one in stretches],
        labels=[f"L{one.identity}: σ up to {100 * one.sigma:.2g} cm" for one in stretches],
        radii=_BAND_WIDTH,
        show_labels=False,
    )
    writer.log("world/confidence/walls", bands)


def _log_weak_places(writer: RrdWriter, weak: Sequence[WeakPlace]) -> None:
    """Log a disc at each weak place, and a dashed line along each drive that would improve one."""
    places = rr.Points3D(
        to_3d(np.array([place.position for place in weak]).reshape(-1, 2), Height.LOOP),
        colors=_WEAK,
        radii=_PLACE_SIZE,
        labels=[f"{place.text}. {place.drive}." for place in weak],
        show_labels=False,
    )
    writer.log("world/confidence/weak", places)
    drives = np.array([[place.position, place.target] for place in weak if place.target is not None])
    lines = to_3d(dashed(drives.reshape(-1, 2, 2)), Height.LOOP)
    writer.log("world/confidence/drives", rr.LineStrips3D(lines, colors=_WEAK, radii=_DRIVE_WIDTH))
