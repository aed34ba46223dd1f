"""Newest state of a live run, in parts of JSON that clients fetch when they are ready for them.

A part replaces its predecessor. So a slow client misses some of them, and nothing is kept for it. A part is encoded
when the first client fetches it, and only then: without clients a run pays for a reference to each event.
"""

from __future__ import annotations

import json
import math
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from drivers import se2
from drivers.se2 import Pose

from ...events import (
    Event,
    Finished,
    KeyframeAdded,
    LoopDecided,
    MapUpdated,
    Notice,
    Relocalised,
    ScanTracked,
    StateChanged,
    SuspectFound,
)
from ...geometry.segments import Floats
from ...loop_closure.loop_status import LoopStatus
from ...mapping.map_features import MapWalls

MAX_POINTS = 720
"""Points of a scan that are sent; a display has no use for more."""
MAX_MESSAGES = 50
"""Doubts and loop closures that are kept, each."""
DIGITS = 3
"""Decimals of metres and radians."""

Payload = Callable[[], Any]
"""Function that returns a part as lists, dictionaries, numbers and texts."""


@dataclass(slots=True)
class _Part:
    """Newest version of a part, and its JSON once it was fetched."""

    version: int
    build: Payload
    text: str | None = None


class LiveState:
    """Sink that keeps the newest state of a run; `frame` may be called from any thread.

    Parts are `map` (walls and path), `recent` (segments and path since then), `scan`, `pose`, `status`, and the tiles
    of the occupancy grid.

    poses_of_scans  True to show the poses of scans; False if `put_pose` is called more often
    changed  called when a part is new, in the thread of the event; to be set by the server
    """

    handled: ClassVar[tuple[type[Event], ...]] = (
        ScanTracked,
        KeyframeAdded,
        MapUpdated,
        StateChanged,
        LoopDecided,
        Notice,
        Relocalised,
        SuspectFound,
        Finished,
    )

    def __init__(self) -> None:
        self.poses_of_scans = True
        self.changed: Callable[[], None] = lambda: None
        self._lock = threading.RLock()
        self._parts: dict[str, _Part] = {}
        self._recent: list[KeyframeAdded] = []
        self._status: dict[str, Any] = {
            "state": "OK", "finished": False, "paused": False, "frozen": False, "message": "",
        }  # fmt: skip
        self._doubts: deque[list[Any]] = deque(maxlen=MAX_MESSAGES)
        self._closures: deque[list[Any]] = deque(maxlen=MAX_MESSAGES)
        self._begin: float | None = None  # stamp of the first scan
        self.update()

    def handle(self, event: Event) -> None:
        """Process one event."""
        match event:
            case ScanTracked():
                self._begin = event.stamp if self._begin is None else self._begin
                self._put("scan", lambda: _scan(event))
                if self.poses_of_scans:
                    self.put_pose(event.stamp, event.pose, event.covariance if event.covariance.any() else None)
            case KeyframeAdded():
                self._recent.append(event)
                self._put_recent()
                self.update(counts=event.counts)
            case MapUpdated():
                self._recent = [keyframe for keyframe in self._recent if keyframe.index > event.index]
                self._put_map(event.walls, event.keyframe_poses)
            case StateChanged():
                self.update(state=event.state)
            case LoopDecided():
                self._append(self._closures, [self._time(event.stamp), str(event.status), _loop_text(event)])
            case Notice() if event.level == "WARN":
                self._add_doubt(event.stamp, event.text)
            case SuspectFound():
                self._append(self._doubts, [None, f"SUSPECT {event.text}"])  # names its time
                self.update(state="SUSPECT")
            case Finished():
                self._recent = []
                self._put_map(event.walls, event.keyframes.poses)
                self.update(finished=True)

    def put_pose(self, stamp: float, pose: Pose, covariance: Floats | None) -> None:
        """Show a pose [x, y, heading] in the map, with its covariance (3, 3) in its own frame if it is known."""
        self._put("pose", lambda: _pose(stamp, pose, covariance))

    def put_tiles(self, tiles: Mapping[tuple[int, int], Payload]) -> None:
        """Show tiles of the occupancy grid, by column and row, instead of those before; all in one frame."""
        with self._lock:
            for (column, row), build in tiles.items():
                self._put(f"tile {column} {row}", build)

    def update(self, **entries: Any) -> None:
        """Replace entries of the status, which are numbers, texts, and lists or dictionaries of these."""
        with self._lock:
            self._status |= entries
            status = self._status | {"doubts": list(self._doubts), "closures": list(self._closures)}
            self._put("status", lambda: status)

    def frame(self, seen: dict[str, int]) -> str | None:
        """Return the parts that are newer than the versions `seen`, as a JSON object, and update these.

        None if there are none.
        """
        with self._lock:
            fresh = {name: part for name, part in self._parts.items() if seen.get(name) != part.version}
            seen.update((name, part.version) for name, part in fresh.items())
        for part in fresh.values():
            part.text = part.text or json.dumps(part.build(), separators=(",", ":"), allow_nan=False)
        return "{" + ",".join(f'"{name}":{part.text}' for name, part in fresh.items()) + "}" if fresh else None

    def _put(self, name: str, build: Payload) -> None:
        with self._lock:
            before = self._parts.get(name)
            self._parts[name] = _Part(1 if before is None else before.version + 1, build)
        self.changed()

    def _put_map(self, walls: MapWalls, keyframes: Floats) -> None:
        self._put("map", lambda: {"walls": _rounded(walls.piece_points()[0].reshape(-1, 4)), "path": _path(keyframes)})
        self._put_recent()

    def _put_recent(self) -> None:
        keyframes = tuple(self._recent)
        self._put("recent", lambda: _recent(keyframes))

    def _add_doubt(self, stamp: float, text: str) -> None:
        self._append(self._doubts, [self._time(stamp), text])

    def _append(self, rows: deque[list[Any]], row: list[Any]) -> None:
        with self._lock:
            rows.append(row)
            self.update()

    def _time(self, stamp: float) -> float:
        """Return seconds since the first scan."""
        return 0.0 if self._begin is None else round(stamp - self._begin, 1)


def _rounded(values: Floats) -> list[Any]:
    """Return an array as lists."""
    rounded: list[Any] = np.round(values, DIGITS).tolist()
    return rounded


def _path(keyframes: Floats) -> list[Any]:
    return _rounded(keyframes[:, :2])


def _scan(event: ScanTracked) -> Mapping[str, Any]:
    """Return the points of a scan in the map."""
    points = event.points[:: -(-len(event.points) // MAX_POINTS) or 1]
    overlap = None if math.isnan(event.overlap_ratio) else event.overlap_ratio  # NaN: there is no wall in the scan
    return {"points": _rounded(se2.transform(event.pose, points)), "stamp": event.stamp, "overlap": overlap}


def _pose(stamp: float, pose: Pose, covariance: Floats | None) -> Mapping[str, Any]:
    """Return a pose, and the covariance of its position in the axes of the map."""
    payload: dict[str, Any] = {"stamp": stamp, "pose": np.round(pose, 4).tolist()}
    if covariance is not None and np.isfinite(covariance).all():
        c, s = np.cos(pose[2]), np.sin(pose[2])
        turn = np.array([[c, -s], [s, c]])
        payload["covariance"] = (turn @ covariance[:2, :2] @ turn.T).tolist()
        payload["sigma_heading"] = float(np.sqrt(covariance[2, 2]))
    return payload


def _recent(keyframes: tuple[KeyframeAdded, ...]) -> Mapping[str, Any]:
    """Return the segments of keyframes that are not in the map yet, and their path."""
    ends = [np.zeros((0, 4))]
    for keyframe in keyframes:
        segments = keyframe.segments
        along = np.stack([np.cos(segments.frame[:, 2]), np.sin(segments.frame[:, 2])], axis=-1)
        reach = segments.half_length[:, None] * along
        begin, end = segments.frame[:, :2] - reach, segments.frame[:, :2] + reach
        ends.append(np.hstack([se2.transform(keyframe.pose, begin), se2.transform(keyframe.pose, end)]))
    poses = np.array([keyframe.pose for keyframe in keyframes]).reshape(-1, 3)
    return {"walls": _rounded(np.concatenate(ends)), "path": _path(poses)}


def _loop_text(event: LoopDecided) -> str:
    place = f"keyframe {event.index} to keyframe {event.old}"
    return (
        f"{place}, moved by {event.shift:.2f} m" if event.status == LoopStatus.ACCEPTED else f"{place}: {event.reason}"
    )
