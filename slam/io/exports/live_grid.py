"""Occupancy grid of a running estimate, corrected where the map was corrected, in a thread of its own.

Keyframes are added as they come. If a correction has moved a point of a keyframe by more than a cell, the keyframe's
beams are removed and drawn again at the new pose. An update draws for a limited time and is followed by a pause in
proportion to that time, so mapping is hardly delayed however much has moved.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2

from ...errors import MapError
from ...geometry.segments import Floats
from .keyframe_points import KeyframePoints
from .occupancy import Occupancy, OccupancyGrid

if TYPE_CHECKING:
    from ..sessions import StoredSession

PAUSE_FACTOR = 9.0
"""Pause after an update, as a multiple of its duration: a tenth of one core at most."""
DRAWING_TIME = 0.01
"""Seconds for which an update draws; what is left is drawn by the next ones."""
FIRST_CAPACITY = 256
"""Keyframes for which there is room at first; the room is doubled when it is full."""


class LiveGrid:
    """Occupancy grid of the keyframes added so far.

    publish  called with each new grid and the stamp of its last keyframe, from the thread

    Methods can be called from another thread. `add` and `move` return at once.
    """

    def __init__(
        self, resolution: float, interval: float, max_range: float, publish: Callable[[float, Occupancy], None]
    ) -> None:
        """`interval` is the least time between two grids, seconds; `max_range` the longest beam drawn, metres."""
        self._resolution, self._interval, self._max_range, self._publish = resolution, interval, max_range, publish
        self._keyframes: list[KeyframePoints] = []
        self._poses = np.zeros((FIRST_CAPACITY, 3))
        self._grid = OccupancyGrid(resolution)
        self._drawn = np.full((FIRST_CAPACITY, 3), np.nan)  # poses at which keyframes are in the grid; NaN if not
        self._reach = np.zeros(FIRST_CAPACITY)  # metres from the base to the farthest point
        self._lock = threading.Lock()  # for the keyframes and their poses
        self._drawing = threading.Lock()  # for the grid and what is drawn in it
        self._ended, self._changed, self._published = threading.Event(), False, float("-inf")
        self._problem = ""
        self._thread = threading.Thread(target=self._run, name="occupancy-grid", daemon=True)
        self._thread.start()

    def add(self, stamp: float, points: Floats, lidars: Floats, pose: se2.Pose) -> None:
        """Add a keyframe: points (n, 2) and lidars (k, 2) in the base's frame, pose (3,) in the map."""
        keyframe = KeyframePoints.within(stamp, points, lidars, self._max_range)
        with self._lock:
            count = len(self._keyframes)
            if count == len(self._poses):
                self._poses = np.concatenate([self._poses, np.zeros_like(self._poses)])
            self._poses[count] = pose
            self._keyframes.append(keyframe)

    def add_session(self, session: StoredSession, lidars: Floats) -> None:
        """Add the keyframes of a session that the run continues; `lidars` (k, 2) on the base, if it states none."""
        poses = session.slam_state.mapper.keyframe_poses
        for keyframe, row in enumerate(session.scan_history().keyframes.tolist()):
            scan = session.scans[row]
            self.add(scan.stamp, scan.features.points.xy, session.lidars_at(scan.stamp, lidars), poses[keyframe])

    def move(self, poses: Floats) -> None:
        """Set the poses (k, 3) of the first k keyframes."""
        with self._lock:
            count = min(len(poses), len(self._keyframes))
            self._poses[:count] = poses[:count]

    def current(self) -> tuple[float, Occupancy] | None:
        """Return the grid up to the last keyframe and its stamp; None without any returns."""
        with self._drawing:
            try:
                stamp, _ = self._draw(float("inf"))
                return stamp, self._grid.occupancy()
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
        self.update(float("inf"))

    def _run(self) -> None:
        pause = 0.0
        while not self._ended.wait(pause):
            before = time.monotonic()
            finished = self.update(DRAWING_TIME)
            pause = PAUSE_FACTOR * (time.monotonic() - before)
            if finished:
                pause = max(self._interval, pause) if np.isfinite(self._published) else 0.1

    def update(self, duration: float) -> bool:
        """Draw for at most `duration` seconds, publish the grid if that is due, and return True if all is drawn.

        It is due when all is drawn, or if that takes longer than the interval between grids.
        """
        with self._drawing:
            try:
                stamp, finished = self._draw(duration)
                due = finished or time.monotonic() > self._published + self._interval
                if not self._changed or not due:
                    return finished
                occupancy = self._grid.occupancy()
            except MapError as error:
                self._problem = str(error)
                return True
            self._changed, self._published, self._problem = False, time.monotonic(), ""
        self._publish(stamp, occupancy)
        return finished

    def _draw(self, duration: float) -> tuple[float, bool]:
        """Draw the latest keyframes that are not in the grid where they are now: one at least, for `duration` seconds.

        Return the stamp of the last keyframe, and True if all are in the grid. Raises MapError if the grid would become
        too large.
        """
        end = time.monotonic() + duration
        with self._lock:
            count = len(self._keyframes)
            poses = self._poses[:count].copy()
        rows = self._to_draw(poses)[::-1].tolist()
        for number, row in enumerate(rows):
            if number and time.monotonic() > end:
                return self._keyframes[count - 1].stamp, False
            keyframe = self._keyframes[row]
            if np.isfinite(self._drawn[row, 0]):
                for scan in keyframe.placed(self._drawn[row]):
                    self._grid.remove(scan)
                self._drawn[row] = np.nan
            self._grid.add_all(keyframe.placed(poses[row]))
            self._drawn[row], self._changed = poses[row], True
        return self._keyframes[count - 1].stamp if count else 0.0, True

    def _to_draw(self, poses: Floats) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """Return the rows of the keyframes that are not drawn, or of which a correction has moved a point by a cell."""
        count, known = len(poses), len(self._drawn)
        if count > known:
            more = max(count, 2 * known) - known
            self._drawn = np.concatenate([self._drawn, np.full((more, 3), np.nan)])
            self._reach = np.concatenate([self._reach, np.zeros(more)])
        drawn = np.isfinite(self._drawn[:count, 0])
        for row in np.flatnonzero(~drawn).tolist():
            self._reach[row] = float(np.abs(self._keyframes[row].points).max(initial=0.0))
        change = se2.between(self._drawn[:count], poses)
        shift = np.hypot(change[:, 0], change[:, 1]) + np.abs(change[:, 2]) * self._reach[:count]
        return np.flatnonzero(~(shift <= self._resolution))  # NaN if it is not drawn
