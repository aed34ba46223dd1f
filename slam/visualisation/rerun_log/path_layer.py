"""Draw paths: the estimate with its keyframes, odometry alone, and ground truth."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import rerun as rr

from drivers import se2

from ...geometry.segments import Floats
from . import colours
from .colours import Colour
from .rrd_writer import RrdWriter
from .shapes import Height, to_3d

BLOCK_SIZE = 128  # points; a block is logged again while it grows, and never after
PATH_SPACING = 0.05  # metres between points of the odometry path and of the true path
SIGMA_LIMITS = 0.05, 0.2  # metres; position sigmas that separate the shades of keyframes

_THIN, _THICK, _DOT = rr.Radius.ui_points(0.7), rr.Radius.ui_points(1.0), rr.Radius.ui_points(1.6)

# Metres that a step of the path must exceed to be no drive, and the same as a multiple of the median step: sparse
# recordings have a pose per metre. Origin: chosen; not measured.
MIN_INTERRUPTION, INTERRUPTION = 1.0, 10.0


class PathLayer:
    """Estimated path and keyframes, odometry path, and true path, each in the map frame."""

    def __init__(self, writer: RrdWriter) -> None:
        self._writer = writer
        self._odometry, self._ground_truth = GrowingPath(), GrowingPath()
        self._map_from_odometry: se2.Pose | None = None  # T_map_odom at the first keyframe
        self._recent: list[se2.Pose] = []  # keyframes since the whole path was drawn
        self._sigmas: dict[int, float] = {}  # of the keyframes' positions, metres
        dots = rr.Points3D.from_fields(radii=_DOT, show_labels=False)
        writer.log_static("world/path/keyframes", dots)
        for name in ("estimate", "recent"):
            style = rr.LineStrips3D.from_fields(colors=colours.ESTIMATE, radii=_THICK)
            writer.log_static(f"world/path/{name}", style)

    def add_keyframe(self, index: int, pose: se2.Pose, odometry: se2.Pose, sigma: float) -> None:
        """Extend the estimated and the odometry path; `sigma` is the largest of the position, metres."""
        if self._map_from_odometry is None:
            self._map_from_odometry = se2.compose(pose, se2.inverse(odometry))
        self._sigmas[index] = sigma
        self._recent.append(pose)
        self._log_strip("recent", np.array(self._recent))
        by_odometry = se2.compose(self._map_from_odometry, odometry)
        self._odometry.append(float(by_odometry[0]), float(by_odometry[1]))

    def add_true_pose(self, pose: se2.Pose) -> None:
        """Extend the true path by a pose in the map frame."""
        self._ground_truth.append(float(pose[0]), float(pose[1]))

    def set_sigmas(self, sigmas: Floats) -> None:
        """Replace the position sigmas (k,) of all keyframes, metres."""
        self._sigmas = dict(enumerate(sigmas.tolist()))

    def log_estimate(self, path: Floats, keyframes: Floats) -> None:
        """Log the whole estimated `path` (n, 3), and the keyframes (k, 3) as dots, darker for less certain ones."""
        self._log_strip("estimate", path)
        self._log_strip("recent", np.empty((0, 2)))
        self._recent = [keyframes[-1]] if len(keyframes) else []
        sigmas = np.array([self._sigmas.get(index, math.nan) for index in range(len(keyframes))])
        shade = np.sum([sigmas > limit for limit in SIGMA_LIMITS], axis=0, dtype=np.intp)
        dots = rr.Points3D.from_fields(
            positions=to_3d(keyframes, Height.KEYFRAME),
            colors=np.array(colours.ESTIMATE_SHADES, dtype=np.uint8)[shade],
            labels=[f"x{index} σ={100 * sigma:.0f} cm" for index, sigma in enumerate(sigmas.tolist())],
        )
        self._writer.log("world/path/keyframes", dots)

    def log_growing_paths(self) -> None:
        """Log the blocks of the odometry path and of the true path that have grown."""
        self._log_blocks("odometry", self._odometry, Height.ODOMETRY, colours.ODOMETRY)
        self._log_blocks("truth", self._ground_truth, Height.GROUND_TRUTH, colours.GROUND_TRUTH)

    def _log_strip(self, name: str, poses: Floats) -> None:
        strips = [to_3d(piece, Height.ESTIMATE) for piece in driven_pieces(poses) if len(piece) > 1]
        self._writer.log_batched(f"world/path/{name}", rr.LineStrips3D, strips=strips)

    def _log_blocks(self, name: str, path: GrowingPath, height: Height, colour: Colour) -> None:
        for number, points in path.changed_blocks():
            strip = rr.LineStrips3D([to_3d(points, height)], colors=colour, radii=_THIN)
            self._writer.log(f"world/{name}/{number}", strip)


def driven_pieces(path: Floats) -> list[Floats]:
    """Return the pieces (k, 2 or more) of a path (n, 2 or more) in metres that were driven without interruption.

    Between the drives of a merged or continued session, and where the robot was carried, there is no path.
    """
    steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
    moving = steps[steps > 0.0]
    if not len(moving):
        return [path]
    interrupted = steps > max(MIN_INTERRUPTION, INTERRUPTION * float(np.median(moving)))
    return np.split(path, np.flatnonzero(interrupted) + 1)


class GrowingPath:
    """A path that only grows, in blocks; logging a long path anew with every keyframe would fill the file.

    Points (x, y) are in metres; points closer than PATH_SPACING to the last one are left out. Full blocks are dropped
    once they were returned by `changed_blocks`.
    """

    def __init__(self) -> None:
        self._first_number = 0  # of the first block in `_blocks`
        self._blocks: list[list[tuple[float, float]]] = [[]]
        self._grown = False

    def append(self, x: float, y: float) -> None:
        """Add a point."""
        block = self._blocks[-1]
        if block and np.hypot(x - block[-1][0], y - block[-1][1]) < PATH_SPACING:
            return
        if len(block) == BLOCK_SIZE:
            block = [block[-1]]  # no gap between the blocks
            self._blocks.append(block)
        block.append((x, y))
        self._grown = True

    def changed_blocks(self) -> Iterator[tuple[int, Floats]]:
        """Yield the number and points (n, 2) of each block that has grown since the last call."""
        if not self._grown:
            return
        yield from [(self._first_number + place, np.array(block)) for place, block in enumerate(self._blocks)]
        self._first_number += len(self._blocks) - 1
        self._blocks, self._grown = self._blocks[-1:], False
