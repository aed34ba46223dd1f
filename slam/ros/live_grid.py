"""Occupancy grid of a running estimate, drawn again when the map was corrected, in a thread of its own.

Keyframes are added as they come. After a correction that moves a drawn keyframe by more than a cell the grid is drawn
from the beginning. A pause after each update, in proportion to what it took, limits its share of the processor.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from drivers import se2

from ..errors import MapError
from ..geometry.segments import Floats
from ..io.exports import Occupancy, OccupancyGrid, PlacedScan

PAUSE_FACTOR = 9.0
"""Pause after an update, as a multiple of its duration: a tenth of one core at most."""


@dataclass(frozen=True, slots=True, eq=False)
class KeyframePoints:
    """Returns of a keyframe's scan in the base's frame, metres, as 32-bit floats.

    points  (n, 2)
    lidars  (k, 2) positions of the lidars
    """

    stamp: float
    points: np.ndarray[tuple[int, int], np.dtype[np.float32]]
    lidars: Floats

    def placed(self, pose: se2.Pose) -> Iterator[PlacedScan]:
        """Yield the scan of each lidar in the map, taken with the base at `pose`.

        Of several lidars the nearest to a point counts as the one that has measured it: they are close together, and
        what one of them sees, others in the direction of the point see too.
        """
        points = np.asarray(self.points, dtype=np.float64)
        nearest = _distances(points, self.lidars).argmin(axis=1)
        for row, lidar in enumerate(self.lidars):
            own = points[nearest == row]
            yield PlacedScan(self.stamp, se2.transform(pose, lidar), se2.transform(pose, own))


class LiveGrid:
    """Occupancy grid of the keyframes added so far.

    publish  called with each new grid and the stamp of its last keyframe, from the thread

    Methods can be called from another thread; they return at once.
    """

    def __init__(
        self, resolution: float, interval: float, max_range: float, publish: Callable[[float, Occupancy], None]
    ) -> None:
        """`interval` is the least time between two updates, seconds; `max_range` the longest beam drawn, metres."""
        self._resolution, self._interval, self._max_range, self._publish = resolution, interval, max_range, publish
        self._keyframes: list[KeyframePoints] = []
        self._poses: list[se2.Pose] = []
        self._grid = OccupancyGrid(resolution)
        self._drawn: list[se2.Pose] = []  # poses at which keyframes are in the grid
        self._lock, self._ended = threading.Lock(), threading.Event()
        self._problem = ""
        self._thread = threading.Thread(target=self._run, name="occupancy-grid", daemon=True)
        self._thread.start()

    def add(self, stamp: float, points: Floats, lidars: Floats, pose: se2.Pose) -> None:
        """Add a keyframe: points (n, 2) and lidars (k, 2) in the base's frame, pose (3,) in the map."""
        near = _distances(points, lidars).min(axis=1) <= self._max_range
        with self._lock:
            self._keyframes.append(KeyframePoints(stamp, points[near].astype(np.float32), lidars.copy()))
            self._poses.append(pose)

    def move(self, poses: Floats) -> None:
        """Set the poses (k, 3) of the first k keyframes."""
        with self._lock:
            self._poses[: len(poses)] = list(poses[: len(self._poses)])

    def current(self) -> tuple[float, Occupancy] | None:
        """Return the grid up to the last keyframe and its stamp; None without any returns."""
        with self._lock:
            keyframes, poses = list(self._keyframes), list(self._poses)
        grid = OccupancyGrid(self._resolution)
        try:
            for keyframe, pose in zip(keyframes, poses, strict=True):
                grid.add_all(keyframe.placed(pose))
            return keyframes[-1].stamp if keyframes else 0.0, grid.occupancy()
        except MapError:
            return None

    @property
    def problem(self) -> str:
        """Reason why there is no grid; empty if there is one, or nothing to draw yet."""
        return self._problem

    def close(self) -> None:
        """Stop the thread, after a last update."""
        self._ended.set()
        self._thread.join()
        self._update()

    def _run(self) -> None:
        pause = 0.0
        while not self._ended.wait(pause):
            before = time.monotonic()
            self._update()
            pause = max(self._interval, PAUSE_FACTOR * (time.monotonic() - before)) if self._drawn else 0.1

    def _update(self) -> None:
        with self._lock:
            keyframes, poses = list(self._keyframes), list(self._poses)
        redraw = self._moved(keyframes, poses)
        if not redraw and len(poses) == len(self._drawn):
            return
        if redraw:
            self._grid, self._drawn = OccupancyGrid(self._resolution), []
        try:
            for keyframe, pose in zip(keyframes[len(self._drawn) :], poses[len(self._drawn) :], strict=True):
                self._grid.add_all(keyframe.placed(pose))
                self._drawn.append(pose)
            self._publish(keyframes[-1].stamp, self._grid.occupancy())
            self._problem = ""
        except MapError as error:
            self._problem = str(error)

    def _moved(self, keyframes: list[KeyframePoints], poses: list[se2.Pose]) -> bool:
        """Return True if a correction has moved a drawn point by more than a cell."""
        count = len(self._drawn)
        if not count:
            return False
        change = se2.between(np.array(self._drawn), np.array(poses[:count]))
        reach = np.array([float(np.abs(keyframe.points).max(initial=0.0)) for keyframe in keyframes[:count]])
        shift = np.hypot(change[:, 0], change[:, 1]) + np.abs(change[:, 2]) * reach
        return bool(shift.max() > self._resolution)


def _distances(points: Floats, lidars: Floats) -> Floats:
    """Return the distances (n, k) of points (n, 2) from lidars (k, 2)."""
    return np.asarray(np.linalg.norm(points[:, None] - lidars, axis=2))
