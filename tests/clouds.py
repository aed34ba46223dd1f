"""Point clouds of a lidar with several rings, as messages."""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.messages import Floats, Scan
from drivers.recordings.point_clouds import POINT_CLOUD
from drivers.recordings.ros_messages import type_store

STORE = type_store("cdr")
TYPES: dict[str, Any] = dict(STORE.types)
FLOAT32, FLOAT64, UINT32 = 7, 8, 6
SIZES = {FLOAT32: "f4", FLOAT64: "f8", UINT32: "u4"}
HEIGHTS = (-0.5, -0.3, 0.0, 0.25, 0.5)
"""Heights of the rings over the lidar where they hit a wall, metres; the third is level."""


def cloud(
    points: Floats,
    stamp: float = 1.0,
    frame: str = "laser",
    times: tuple[str, int, Floats] | None = None,
    padding: int = 0,
) -> bytes:
    """Return a PointCloud2 with points (n, 3) and perhaps the name, type and values (n,) of a field of times."""
    columns = [(name, FLOAT32, points[:, k]) for k, name in enumerate("xyz")]
    columns += [("intensity", FLOAT32, np.zeros(len(points)))] + ([] if times is None else [times])
    layout = np.dtype([(name, "<" + SIZES[kind]) for name, kind, _ in columns] + [("unused", "V3")])
    cells = np.zeros(len(points), dtype=layout)
    for name, _, values in columns:
        cells[name] = values
    offsets = [layout.fields[name][1] for name, _, _ in columns]
    fields = [
        TYPES["sensor_msgs/msg/PointField"](name, offset, kind, 1)
        for (name, kind, _), offset in zip(columns, offsets, strict=True)
    ]
    seconds = int(stamp)
    time = TYPES["builtin_interfaces/msg/Time"](seconds, round((stamp - seconds) * 1e9))
    data = np.concatenate([np.frombuffer(cells.tobytes(), dtype=np.uint8), np.zeros(padding, dtype=np.uint8)])
    message = TYPES[POINT_CLOUD](
        TYPES["std_msgs/msg/Header"](time, frame), 1, len(points), fields, False, layout.itemsize, len(data), data, True
    )
    return bytes(STORE.serialize_cdr(message, POINT_CLOUD))


def cloud_of_scan(scan: Scan, frame: str = "laser") -> bytes:
    """Return the cloud of a lidar whose level ring measures a scan; the other rings hit the same walls, which are high,
    and the floor under a table in front of them.
    """
    seen = np.isfinite(scan.ranges)
    ranges, angles, offsets = scan.ranges[seen], scan.angles[seen], scan.time_offsets[seen]
    x, y = ranges * np.cos(angles), ranges * np.sin(angles)
    rings = [np.column_stack([x, y, np.full(len(x), height)]) for height in HEIGHTS]
    rings[0] *= [0.5, 0.5, 1.0]
    points, times = np.concatenate(rings), np.tile(offsets, len(rings))
    return cloud(points, scan.stamp, frame, ("time", FLOAT32, times))
