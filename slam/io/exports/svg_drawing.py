"""Draw the map as SVG elements, for the SVG export and the report page.

One unit is a metre. SVG's y axis points down, so y is negated. Elements have CSS classes; the document that contains
them sets their style.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape

import numpy as np

from ...checks.weak_places import WeakKind
from ...geometry.segments import Floats
from ...loop_closure.loop_status import LoopStatus
from ...mapping.map_features import Keyframes, MapCorners, MapWalls
from ..run_results import RunResults
from ..tum import Trajectory
from .confidence import CLASS_LIMITS, WallStretch, wall_stretches, weak_places
from .path_thinning import thin_path

MARGIN = 0.04
"""Width of the margin, as a share of the drawing's larger extent."""
SIGMAS = 3.0
"""Standard deviations of the ellipses' half axes."""
MAX_ELLIPSE = 0.75
"""Metres, largest half axis of a corner's ellipse that is drawn. Larger ones are due to drift that the corners around
share, or belong to an unconnected part of the map, and would cover the walls between them.
"""
SVG_BAND_WIDTH = 0.005
"""Width of the band on the side that a wall is seen from, as a share of the drawing's larger extent."""
MARKER_SIZE = 0.008
"""Radius of the marker at the start of the path, as a share of the drawing's larger extent."""


@dataclass(frozen=True, slots=True)
class PathClass:
    """Class of uncertainty of path and walls: standard deviations below `below` metres, drawn in `colour`."""

    name: str
    below: float
    colour: str


COLOURS = ("#0d0887", "#6a00a8", "#b12a90", "#e16462", "#f89540")
PATH_CLASSES = tuple(
    PathClass(f"p{k}", below, colour)
    for k, (below, colour) in enumerate(zip((*CLASS_LIMITS, np.inf), COLOURS, strict=True))
)
"""Brighter for larger uncertainty, after matplotlib's plasma: distinguishable by lightness and if colour-blind."""
UNKNOWN_CLASS = PathClass("p", np.nan, "#0072b2")


@dataclass(frozen=True, slots=True)
class Drawing:
    """SVG elements and their view box in SVG's axes, metres.

    classes  classes of uncertainty that occur
    """

    elements: str
    left: float
    top: float
    width: float
    height: float
    classes: tuple[PathClass, ...]

    @property
    def view_box(self) -> str:
        """Value of the attribute viewBox."""
        return f"{self.left:.3f} {self.top:.3f} {self.width:.3f} {self.height:.3f}"


def draw_map(results: RunResults, *, timed: bool = False, confidence: bool = False) -> Drawing:
    """Draw walls with the side they are seen from, corners with ellipses, loop closures, and the path with its ends.

    timed       add the seconds since the start to the path and to loop closures, a marker for the robot, and rejected
                loops
    confidence  add the confidence map: bands behind walls in the colours of their classes, and weak places
    """
    points = np.concatenate([results.walls.end_points().reshape(-1, 2), results.trajectory.poses[:, :2]])
    low, high = points.min(axis=0), points.max(axis=0)
    extent = float(max(*(high - low), 1.0))
    middle, size = (low + high) / 2, np.maximum(high - low, extent / 4) + 2 * MARGIN * extent
    began = float(results.trajectory.stamps[0])
    runs = [run for drive in results.drives() for run in _path_runs(drive, results.keyframes, began)]
    used = {run_class.name for run_class, *_ in runs}
    stretches = wall_stretches(results.walls) if confidence else []
    used |= {PATH_CLASSES[stretch.level].name for stretch in stretches}
    groups = [
        ("seen", _bands(results.walls, SVG_BAND_WIDTH * extent)),
        *([("confidence", _confidence_bands(stretches, SVG_BAND_WIDTH * extent))] if confidence else []),
        ("path", (_polyline(run_class.name, run, times if timed else None) for run_class, run, times in runs)),
        ("walls", _walls(results.walls)),
        ("loops", _loop_closures(results, timed=timed)),
        ("corners", _corners(results.corners)),
        ("ends", _end_markers(results.trajectory.poses, MARKER_SIZE * extent, robot=timed)),
        *([("weak", _weak_places(results, MARKER_SIZE * extent))] if confidence else []),
    ]
    elements = "\n".join(f'<g class="{name}">\n' + "\n".join(group) + "\n</g>" for name, group in groups)
    left, top = middle[0] - size[0] / 2, -middle[1] - size[1] / 2
    classes = tuple(c for c in (*PATH_CLASSES, UNKNOWN_CLASS) if c.name in used)
    return Drawing(elements, float(left), float(top), float(size[0]), float(size[1]), classes)


def _walls(walls: MapWalls) -> Iterator[str]:
    """Yield a path for each wall, made of its observed pieces, with a tooltip."""
    points, wall = walls.piece_points()
    for k in range(len(walls)):
        pieces = " ".join(f"M{_xy(start)}L{_xy(end)}" for start, end in points[wall == k])
        length = walls.high[k] - walls.low[k]
        text = f"wall {walls.identity[k]}: {length:.2f} m, observed in {walls.observations[k]} keyframes"
        variances = np.diagonal(walls.covariance[k])
        if np.isfinite(variances).all():
            offset, heading = 1e3 * np.sqrt(variances[0]), np.degrees(np.sqrt(variances[1]))
            text += f", standard deviation {offset:.1f} mm across and {heading:.2f}°"
        yield f'<path data-wall="{walls.identity[k]}" d="{pieces}"><title>{escape(text)}</title></path>'


def _confidence_bands(stretches: list[WallStretch], width: float) -> Iterator[str]:
    """Yield a band along each stretch of a wall, on the side that it is not seen from, with a tooltip."""
    for stretch in stretches:
        start, end = stretch.points
        dx, dy = (end - start) / np.hypot(*(end - start))
        behind = width * np.array([dy, -dx])
        corners = "L".join(_xy(corner) for corner in (start, end, end + behind, start + behind))
        text = (
            f"wall {stretch.identity}: standard deviation {1e3 * stretch.sigma:.0f} mm across, relative to the origin"
        )
        name = PATH_CLASSES[stretch.level].name
        yield f'<path class="{name}" d="M{corners}Z"><title>{escape(text)}</title></path>'


def _weak_places(results: RunResults, size: float) -> Iterator[str]:
    """Yield a ring for each weak place, and a line to the place that a drive should lead to."""
    for place in weak_places(results):
        x, y = _xy(place.position).split(",")
        title = f"<title>{escape(f'{place.text}. {place.drive}.')}</title>"
        if place.target is not None:
            yield f'<path class="drive" d="M{_xy(place.position)}L{_xy(place.target)}">{title}</path>'
        radius = size if place.kind is WeakKind.WALL else 2 * size
        yield f'<circle class="{place.kind}" cx="{x}" cy="{y}" r="{radius:.3f}">{title}</circle>'


def _bands(walls: MapWalls, width: float) -> Iterator[str]:
    """Yield a band along each piece of a wall, on the side that it is seen from."""
    ends, wall = walls.piece_points()
    heading = walls.frame[wall, 2]
    left = width * np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    for (start, end), offset in zip(ends, left, strict=True):
        yield f'<path d="M{_xy(start)}L{_xy(end)}L{_xy(end + offset)}L{_xy(start + offset)}Z"/>'


def _corners(corners: MapCorners) -> Iterator[str]:
    """Yield a dot for each corner, and an ellipse of SIGMAS standard deviations, if known and up to MAX_ELLIPSE."""
    for k in range(len(corners)):
        x, y = corners.position[k]
        text = f"corner {corners.identity[k]}: observed in {corners.observations[k]} keyframes"
        if np.isfinite(corners.covariance[k]).all():
            variances, directions = np.linalg.eigh(corners.covariance[k])
            sigma = np.sqrt(variances.clip(min=0.0))
            text += f", standard deviation {1e3 * sigma[1]:.1f} mm"
            if SIGMAS * sigma[1] <= MAX_ELLIPSE:
                turn = -np.degrees(np.arctan2(directions[1, 1], directions[0, 1]))
                yield (
                    f'<ellipse rx="{SIGMAS * sigma[1]:.4f}" ry="{SIGMAS * sigma[0]:.4f}" '
                    f'transform="translate({_xy([x, y])})rotate({turn:.1f})"/>'
                )
        yield f'<path class="dot" d="M{_xy([x, y])}h0"><title>{escape(text)}</title></path>'


def _path_runs(
    trajectory: Trajectory, keyframes: Keyframes | None, began: float
) -> Iterator[tuple[PathClass, Floats, Floats]]:
    """Yield runs of the path (n, 2) of one drive with one class of uncertainty, and seconds (n,) since `began`.

    A run starts at the last point of the one before.
    """
    rows = thin_path(trajectory.poses)
    points, times = trajectory.poses[rows, :2], trajectory.stamps[rows] - began
    classes = [UNKNOWN_CLASS] * len(points)
    if keyframes is not None and np.isfinite(sigma := keyframes.position_sigma()).any():
        known = np.isfinite(sigma)
        interpolated = np.interp(trajectory.stamps[rows], keyframes.stamps[known], sigma[known])
        classes = [next(c for c in PATH_CLASSES if value < c.below) for value in interpolated]
    start = 0
    for run_class, members in itertools.groupby(classes):
        count = len(list(members))
        chosen = slice(max(start - 1, 0), start + count)
        yield run_class, points[chosen], times[chosen]
        start += count


def _polyline(name: str, points: Floats, times: Floats | None) -> str:
    data = "" if times is None else f' data-times="{" ".join(f"{time:.1f}" for time in times)}"'
    return f'<polyline class="{name}"{data} points="{" ".join(_xy(point) for point in points)}"/>'


def _loop_closures(results: RunResults, *, timed: bool) -> Iterator[str]:
    """Yield a line for each loop closure that was accepted or retracted, from its keyframe to the old keyframe.

    If `timed`, also for rejected ones, and with the seconds since the start.
    """
    if results.keyframes is None:
        return
    for row in (results.summary.get("slam") or {}).get("loop_decisions") or []:
        if row["status"] not in (LoopStatus.ACCEPTED, LoopStatus.RETRACTED) and not timed:
            continue
        time = f' data-time="{row["stamp"] - results.trajectory.stamps[0]:.1f}"' if timed else ""
        start, end = results.keyframes.poses[[row["keyframe"], row["old"]], :2]
        text = f"loop {row['candidate']}, {row['status']}: keyframe {row['keyframe']} at the place of {row['old']}"
        yield (
            f'<path class="{escape(str(row["status"]))}" data-loop="{escape(str(row["candidate"]))}"{time} '
            f'd="M{_xy(start)}L{_xy(end)}"><title>{escape(text)}</title></path>'
        )


def _end_markers(poses: Floats, size: float, *, robot: bool) -> Iterator[str]:
    """Yield a ring at the start of the path and an arrow at its end, in the direction of the robot's heading.

    If `robot`, also a disc that shows where it is at another time.
    """
    start, end = poses[0], poses[-1]
    x, y = _xy(start).split(",")
    yield f'<circle class="start" cx="{x}" cy="{y}" r="{size:.3f}"><title>start</title></circle>'
    angles = end[2] + np.array([0.0, 2.5, -2.5])
    vertices = end[:2] + 1.5 * size * np.column_stack([np.cos(angles), np.sin(angles)])
    yield f'<polygon class="end" points="{" ".join(_xy(vertex) for vertex in vertices)}"><title>end</title></polygon>'
    if robot:
        yield f'<circle class="robot" r="{1.2 * size:.3f}" visibility="hidden"/>'


def _xy(point: Floats | list[float]) -> str:
    """Return a point in SVG's axes, rounded to millimetres."""
    return f"{point[0]:z.3f},{-point[1]:z.3f}"
