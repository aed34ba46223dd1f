"""The map as elements of SVG, for the picture and for the page: one unit is a metre, y points up and is written down.

Every element has a class, so that whatever holds the drawing decides how it looks.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape

import numpy as np

from ...events import MapCorners, MapWalls
from ..keyframes_csv import Keyframes
from ..tum import Floats, Trajectory
from .session import Session
from .thinning import thinned

MARGIN = 0.04
"""Free room around what is drawn, as a share of its larger extent."""
SIGMAS = 3.0
BAND = 0.005
"""Width of the band on the side that a wall is seen from, as a share of the drawing's larger extent."""


@dataclass(frozen=True, slots=True)
class PathClass:
    """A class of the path's uncertainty: standard deviations below `below` metres, drawn in `colour`."""

    name: str
    below: float
    colour: str


PATH_CLASSES = (
    PathClass("p0", 0.02, "#0d0887"),
    PathClass("p1", 0.05, "#6a00a8"),
    PathClass("p2", 0.1, "#b12a90"),
    PathClass("p3", 0.2, "#e16462"),
    PathClass("p4", np.inf, "#f89540"),
)
"""The worse the brighter, after matplotlib's plasma: told apart by colour-blind eyes, and by their lightness."""
UNKNOWN_CLASS = PathClass("p", np.nan, "#0072b2")


@dataclass(frozen=True, slots=True)
class Drawing:
    """SVG `elements` and their view box: `left` and `top` in SVG's axes, metres. `classes` are those of the path's
    uncertainty that occur."""

    elements: str
    left: float
    top: float
    width: float
    height: float
    classes: tuple[PathClass, ...]

    @property
    def view_box(self) -> str:
        """As the attribute has it."""
        return f"{self.left:.3f} {self.top:.3f} {self.width:.3f} {self.height:.3f}"


def draw(session: Session) -> Drawing:
    """Walls with the side they are seen from, corners with their ellipses of SIGMAS, the path and its two ends."""
    points = np.concatenate([session.lines.end_points().reshape(-1, 2), session.trajectory.poses[:, :2]])
    low, high = points.min(axis=0), points.max(axis=0)
    extent = float(max(*(high - low), 1.0))
    middle, size = (low + high) / 2, np.maximum(high - low, extent / 4) + 2 * MARGIN * extent
    runs = list(_path(session.trajectory, session.keyframes))
    used = {run_class.name for run_class, _ in runs}
    groups = [
        ("seen", _bands(session.lines, BAND * extent)),
        ("path", (_polyline(run_class.name, run) for run_class, run in runs)),
        ("walls", _walls(session.lines)),
        ("loops", _loops(session)),
        ("corners", _corners(session.corners)),
        ("ends", _ends(session.trajectory.poses, 0.008 * extent)),
    ]
    elements = "\n".join(f'<g class="{name}">\n' + "\n".join(group) + "\n</g>" for name, group in groups)
    left, top = middle[0] - size[0] / 2, -middle[1] - size[1] / 2
    classes = tuple(c for c in (*PATH_CLASSES, UNKNOWN_CLASS) if c.name in used)
    return Drawing(elements, float(left), float(top), float(size[0]), float(size[1]), classes)


def _walls(lines: MapWalls) -> Iterator[str]:
    """A path for each wall, of its pieces, that can be asked about."""
    points, wall = lines.piece_points()
    for k in range(len(lines)):
        ends = " ".join(f"M{_xy(start)}L{_xy(end)}" for start, end in points[wall == k])
        length = lines.high[k] - lines.low[k]
        about = f"wall {lines.identity[k]}: {length:.2f} m, seen in {lines.observations[k]} keyframes"
        variances = np.diagonal(lines.covariance[k])
        if np.isfinite(variances).all():
            offset, heading = 1e3 * np.sqrt(variances[0]), np.degrees(np.sqrt(variances[1]))
            about += f", known to {offset:.1f} mm across and {heading:.2f}°"
        yield f'<path d="{ends}"><title>{escape(about)}</title></path>'


def _bands(lines: MapWalls, width: float) -> Iterator[str]:
    ends, wall = lines.piece_points()
    heading = lines.frame[wall, 2]
    left = width * np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    for (start, end), aside in zip(ends, left, strict=True):
        yield f'<path d="M{_xy(start)}L{_xy(end)}L{_xy(end + aside)}L{_xy(start + aside)}Z"/>'


def _corners(corners: MapCorners) -> Iterator[str]:
    """A dot for each corner and, where its covariance is known, an ellipse of SIGMAS."""
    for k in range(len(corners)):
        x, y = corners.position[k]
        about = f"corner {corners.identity[k]}: seen in {corners.observations[k]} keyframes"
        if np.isfinite(corners.covariance[k]).all():
            variances, directions = np.linalg.eigh(corners.covariance[k])
            sigma = np.sqrt(variances.clip(min=0.0))
            about += f", known to {1e3 * sigma[1]:.1f} mm"
            turn = -np.degrees(np.arctan2(directions[1, 1], directions[0, 1]))
            yield (
                f'<ellipse rx="{SIGMAS * sigma[1]:.4f}" ry="{SIGMAS * sigma[0]:.4f}" '
                f'transform="translate({_xy([x, y])})rotate({turn:.1f})"/>'
            )
        yield f'<path class="dot" d="M{_xy([x, y])}h0"><title>{escape(about)}</title></path>'


def _path(trajectory: Trajectory, keyframes: Keyframes | None) -> Iterator[tuple[PathClass, Floats]]:
    """The path in runs (n, 2) of one class of uncertainty; the first point of a run is the last of the one before."""
    kept = thinned(trajectory.poses)
    points = trajectory.poses[kept, :2]
    of_each = [UNKNOWN_CLASS] * len(points)
    if keyframes is not None and np.isfinite(sigma := keyframes.sigma()).any():
        known = np.isfinite(sigma)
        here = np.interp(trajectory.stamps[kept], keyframes.stamps[known], sigma[known])
        of_each = [next(c for c in PATH_CLASSES if value < c.below) for value in here]
    start = 0
    for run_class, members in itertools.groupby(of_each):
        count = len(list(members))
        yield run_class, points[max(start - 1, 0) : start + count]
        start += count


def _polyline(name: str, points: Floats) -> str:
    return f'<polyline class="{name}" points="{" ".join(_xy(point) for point in points)}"/>'


def _loops(session: Session) -> Iterator[str]:
    """From the keyframe at which a loop was closed, or taken back, to the old keyframe that saw the place."""
    if session.keyframes is None:
        return
    for row in (session.summary.get("slam") or {}).get("loop_decisions") or []:
        if row["status"] not in ("accepted", "retracted"):
            continue
        here, there = session.keyframes.poses[[row["keyframe"], row["old"]], :2]
        about = f"loop {row['candidate']}, {row['status']}: keyframe {row['keyframe']} sees the place of {row['old']}"
        yield (
            f'<path class="{row["status"]}" data-loop="{row["candidate"]}" d="M{_xy(here)}L{_xy(there)}">'
            f"<title>{escape(about)}</title></path>"
        )


def _ends(poses: Floats, size: float) -> Iterator[str]:
    """A ring where the path starts; an arrow where the robot stands at its end, pointing where it looks."""
    start, end = poses[0], poses[-1]
    x, y = _xy(start).split(",")
    yield f'<circle class="start" cx="{x}" cy="{y}" r="{size:.3f}"><title>start</title></circle>'
    angles = end[2] + np.array([0.0, 2.5, -2.5])
    tips = end[:2] + 1.5 * size * np.column_stack([np.cos(angles), np.sin(angles)])
    yield f'<polygon class="end" points="{" ".join(_xy(tip) for tip in tips)}"><title>end</title></polygon>'


def _xy(point: Floats | list[float]) -> str:
    """A point in SVG's axes, millimetres."""
    return f"{point[0]:z.3f},{-point[1]:z.3f}"
