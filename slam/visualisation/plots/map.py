"""Plot the map and the path, seen from above."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...formatting import counted
from ...geometry.segments import Floats
from ...io.exports.svg_drawing import MAX_ELLIPSE
from ...io.tum import Trajectory
from ...mapping.map_features import MapCorners, MapWalls
from .style import BLUE, GREEN, INK, ORANGE, PURPLE, SKY, ellipses, legend, metric_figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BAND_WIDTH = 0.0055
"""Width of the band on the seen side of a wall, relative to the plot's larger extent."""


def plot_map(
    path: Path,
    walls: MapWalls,
    corners: MapCorners,
    drives: Sequence[Trajectory],
    *,
    title: str,
    odometry: Floats | None = None,
    truth: Floats | None = None,
) -> None:
    """Plot walls, corners and the path of each drive, and odometry and truth (m, 3) if given, all in the map frame.

    The plot's extent is that of map and path; odometry may leave it. Raises OutputError.
    """
    poses = np.concatenate([drive.poses for drive in drives])
    drawn = np.concatenate([walls.end_points().reshape(-1, 2), poses[:, :2]])
    sizes = f"{counted(len(walls), 'wall')}, {counted(len(corners), 'corner')}"
    subtitle = f"{sizes}, {sum(drive.length for drive in drives):.1f} m driven"
    figure, axes = metric_figure(np.array([drawn.min(axis=0), drawn.max(axis=0)]), title, subtitle)
    if odometry is not None:
        dashes: dict[str, Any] = {"linestyle": (0, (4, 2)), "linewidth": 1.0}
        axes.plot(*odometry[:, :2].T, color=ORANGE, **dashes, label="odometry alone", zorder=2)
    if truth is not None:
        axes.plot(*truth[:, :2].T, color=GREEN, linewidth=4.0, alpha=0.3, label="true path", zorder=3)
    for k, drive in enumerate(drives):
        axes.plot(*drive.poses[:, :2].T, color=BLUE, linewidth=1.2, label=None if k else "path", zorder=4)
    _ends(axes, poses)
    _walls(axes, walls)
    _corners(axes, corners)
    legend(axes)
    save(figure, path)


def _ends(axes: Axes, poses: Floats) -> None:
    """Mark the start of the path, and the pose at its end."""
    start, end = poses[0], poses[-1]
    ring: dict[str, Any] = {"marker": "o", "markersize": 6, "color": "white", "markeredgecolor": BLUE}
    axes.plot(start[0], start[1], **ring, linestyle="", label="start", zorder=8)
    arrow: dict[str, Any] = {"marker": (3, 0, np.degrees(end[2]) - 90), "markersize": 11, "color": BLUE}
    axes.plot(end[0], end[1], **arrow, markeredgecolor="white", linestyle="", label="end", zorder=8)


def _walls(axes: Axes, walls: MapWalls) -> None:
    """Draw each wall as a line with a light band on its seen side."""
    from matplotlib.collections import LineCollection, PolyCollection

    ends, wall = walls.piece_points()
    width = BAND_WIDTH * max(np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim()))
    heading = walls.frame[wall, 2]
    left = width * np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    bands = np.stack([ends[:, 0], ends[:, 1], ends[:, 1] + left, ends[:, 0] + left], axis=1)
    axes.add_collection(
        PolyCollection(list(bands), facecolor=SKY, alpha=0.35, linewidth=0, label="seen side", zorder=1)
    )
    axes.add_collection(LineCollection(list(ends), color=INK, linewidth=1.5, capstyle="round", label="wall", zorder=5))


def _corners(axes: Axes, corners: MapCorners) -> None:
    if len(corners) == 0:
        return
    name = ellipses(axes, corners.position, corners.covariance, PURPLE, enlarged=False, largest=MAX_ELLIPSE)
    axes.plot(*corners.position.T, ".", color=PURPLE, markersize=3.5, label=f"corner, {name}", zorder=7)
