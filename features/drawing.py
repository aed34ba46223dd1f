"""Draw the features of one scan as SVG, seen from above in the frame of the lidar: x to the right, y up."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .types import Corners, Features, Lines

MARGIN = 0.05
"""Width of the margin, as a share of the drawing's larger extent."""
WIDTH = 640
"""Width of the drawing, pixels."""
ELLIPSE_SIZE = 0.03
"""Half axis of the largest ellipse, as a share of the drawing's larger extent; all are enlarged by one factor."""
SIGMAS = 3.0
"""Standard deviations of the ellipses' half axes, before they are enlarged."""


def draw(features: Features) -> str:
    """Return lines with their numbers, corners with enlarged 3-sigma ellipses, and the lidar, as SVG."""
    points = np.concatenate([np.zeros((1, 2)), features.lines.start, features.lines.end, features.corners.position])
    low, high = points.min(axis=0), points.max(axis=0)
    extent = float(max(*(high - low), 1.0))
    size = high - low + 2 * MARGIN * extent
    left, top = low[0] - MARGIN * extent, -high[1] - MARGIN * extent
    factor = _enlargement(features.corners, extent)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{WIDTH * size[1] / size[0]:.0f}" '
        f'viewBox="{left:.3f} {top:.3f} {size[0]:.3f} {size[1]:.3f}">',
        f"<title>{len(features.lines)} lines, {len(features.corners)} corners; ellipses: 3 sigma, enlarged "
        f"{factor:.0f} times</title>",
        f'<path d="M{0.03 * extent:.3f},0l{-0.05 * extent:.3f},{0.02 * extent:.3f}v{-0.04 * extent:.3f}z" '
        'fill="#1f2933"><title>lidar</title></path>',
        *_lines(features.lines, extent),
        *_corners(features.corners, extent, factor),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _lines(lines: Lines, extent: float) -> Iterator[str]:
    for number, ((x0, y0), (x1, y1)) in enumerate(zip(lines.start, lines.end, strict=True)):
        distance = 1.0 / np.hypot(*lines.uv[number])
        gradient = -(distance**3) * lines.uv[number]
        sigma = float(np.sqrt(gradient @ lines.covariance[number] @ gradient))
        yield (
            f'<path d="M{x0:.3f},{-y0:.3f}L{x1:.3f},{-y1:.3f}" stroke="#0072b2" stroke-width="{0.006 * extent:.4f}">'
            f"<title>line {number}: {distance:.3f} m away ± {1000 * sigma:.1f} mm, from {lines.count[number]} rays"
            "</title></path>"
        )
        x, y = 0.47 * (x0 + x1), -0.47 * (y0 + y1)
        yield (
            f'<text x="{x:.3f}" y="{y:.3f}" font-size="{0.03 * extent:.3f}" font-family="sans-serif" fill="#0072b2" '
            f'text-anchor="middle">{number}</text>'
        )


def _corners(corners: Corners, extent: float, factor: float) -> Iterator[str]:
    for (x, y), covariance in zip(corners.position, corners.covariance, strict=True):
        variances, axes = np.linalg.eigh(covariance)
        small, large = SIGMAS * np.sqrt(np.maximum(variances, 0.0))
        turn = -np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
        yield (
            f'<ellipse transform="translate({x:.3f} {-y:.3f})rotate({turn:.1f})" rx="{factor * large:.4f}" '
            f'ry="{factor * small:.4f}" fill="#d55e00" fill-opacity=".3" stroke="#d55e00" '
            f'stroke-width="{0.002 * extent:.4f}"><title>corner at {x:.3f}, {y:.3f} m ± {1000 * large / SIGMAS:.1f} mm '
            "at most</title></ellipse>"
        )


def _enlargement(corners: Corners, extent: float) -> float:
    """Return the factor by which ellipses are enlarged, at least 1."""
    if not len(corners):
        return 1.0
    largest = SIGMAS * float(np.sqrt(np.linalg.eigvalsh(corners.covariance).max()))
    return max(1.0, np.floor(ELLIPSE_SIZE * extent / largest)) if largest > 0.0 else 1.0
