"""Scans from point clouds (sensor_msgs/PointCloud2): the points at a height above the floor, as a 2-D lidar sees them.

In each direction the point nearest to the height is taken, not the nearest to the lidar, which would be biased by the
noise of all points in that direction. A beam keeps the exact direction of its point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..messages import Floats, Scan
from .ros_messages import LidarMount, stamp_of

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
BEAM_WIDTH = math.radians(0.25)
"""Radians between two beams of the scan. Origin: chosen; lidars that make clouds have steps of 0.1 to 0.4 degrees."""
MAX_DURATION = 2.0
"""Seconds that the points of a cloud may take; if times say otherwise, they mean something else. Origin: chosen."""
MIN_DATE = 1e6
"""Seconds from which on a time is no offset from the stamp but a date. Origin: definition."""
MIN_NANOSECONDS = 1e12
"""Floating-point times from here on are nanoseconds. Origin: definition; as seconds it is after the year 30000."""
TIME_FIELDS = ("time", "t", "timestamp", "time_stamp", "offset_time")
"""Names of the field with the time of each point, as common drivers call it."""
DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Types of fields, by the constants of sensor_msgs/PointField."""


@dataclass(frozen=True, slots=True)
class HeightCut:
    """Layer of a point cloud that becomes a scan.

    height     metres above the origin of the base; None: of the lidar itself
    thickness  metres, half of it above the height and half below
    """

    height: float | None = None
    thickness: float = 0.2


def scan_of_cloud(message: Any, received: int, pose: Floats | None, mount: LidarMount, cut: HeightCut) -> Scan:
    """Convert a PointCloud2 to a Scan, in which there are beams only where there are points at the height.

    received  time of reception, nanoseconds; the stamp if the header has none
    pose      (4, 4) of the lidar in the base's frame; None if unknown: it is level then, and at the height 0
    mount     the same in the plane, for the scan

    Raises ValueError if the message is invalid or no point is at the height.
    """
    fields = {field.name: field for field in message.fields}
    if any(name not in fields for name in "xyz"):
        raise ValueError("points have no x, y and z")
    time_field = next((name for name in TIME_FIELDS if name in fields), None)
    names = [*"xyz", *([] if time_field is None else [time_field])]
    cells = _cells(message, {name: fields[name] for name in names})
    pose = np.eye(4) if pose is None else pose
    height = float(pose[2, 3]) if cut.height is None else cut.height
    inside = _in_layer(cells, pose, height, 0.5 * cut.thickness)
    level = _turned(np.column_stack([cells[name][inside].astype(np.float64) for name in "xyz"]), pose, mount)
    ranges = np.hypot(level[:, 0], level[:, 1])
    bearings, distance = np.arctan2(level[:, 1], level[:, 0]), np.abs(level[:, 2] - height)
    chosen = _one_for_each_beam(bearings, distance, np.flatnonzero((ranges > 0.0) & (ranges < math.inf)))
    if not len(chosen):
        raise ValueError(f"no points at a height of {height:g} m")
    stamp = stamp_of(message.header, received)
    offsets = np.zeros(len(chosen)) if time_field is None else _time_offsets(cells[time_field][inside[chosen]], stamp)
    first = float(offsets.min())
    angles, offsets = bearings[chosen], offsets - first
    angles.flags.writeable = offsets.flags.writeable = False  # as of other scans, for which functions are compiled
    return Scan(stamp + first, ranges[chosen], angles, offsets, 0.0, math.inf, mount.pose)


def _cells(message: Any, fields: dict[str, Any]) -> NDArray[np.void]:
    """Return the points (n,) of a cloud as a structured array; raises ValueError if its sizes contradict each other."""
    order = ">" if message.is_bigendian else "<"
    if any(field.datatype not in DATATYPES for field in fields.values()):
        raise ValueError("points have a field of unknown type")
    layout = np.dtype(
        {
            "names": list(fields),
            "formats": [order + DATATYPES[field.datatype] for field in fields.values()],
            "offsets": [field.offset for field in fields.values()],
            "itemsize": message.point_step,
        }
    )
    width, height = message.width * message.point_step, message.height
    data = np.asarray(message.data, dtype=np.uint8)
    if message.row_step < width or len(data) < message.row_step * height or not width * height:
        raise ValueError("point cloud is empty or incomplete")
    rows = data[: message.row_step * height].reshape(height, message.row_step)[:, :width]
    return np.ascontiguousarray(rows).reshape(-1).view(layout)


def _in_layer(cells: NDArray[np.void], pose: Floats, height: float, half: float) -> NDArray[np.int64]:
    """Return the rows of the points at most `half` metres above or below a height over the base's origin.

    Most points of a cloud are elsewhere, so everything else is computed for these only.
    """
    with np.errstate(invalid="ignore", over="ignore"):  # damaged bytes may be signalling NaNs
        z = sum(factor * cells[name] for factor, name in zip(pose[2, :3].tolist(), "xyz", strict=True) if factor)
        return np.flatnonzero(np.abs(z + (pose[2, 3] - height)) <= half)  # false for nan


def _turned(points: Floats, pose: Floats, mount: LidarMount) -> Floats:
    """Return points (n, 3) in a level frame at the lidar with the heading of its mount, z from the base's origin."""
    heading = 0.0 if mount.pose is None else float(mount.pose[2])
    c, s = math.cos(heading), math.sin(heading)
    rotation = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ pose[:3, :3]
    return np.asarray(points @ rotation.T + [0.0, 0.0, pose[2, 3]])


def _one_for_each_beam(bearings: Floats, distance: Floats, candidates: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the candidates with the least distance within each BEAM_WIDTH, in the order of their bearings.

    The points of one direction may be at either side of the limit between two beams, so of two that are nearer to each
    other than half a beam only the better one is kept.
    """
    beams = np.floor((bearings[candidates] + math.pi) / BEAM_WIDTH)
    order = np.lexsort((distance[candidates], beams))
    _, first = np.unique(beams[order], return_index=True)
    chosen = candidates[order[first]]
    if len(chosen) < 2:
        return chosen
    near = np.diff(bearings[chosen]) < 0.5 * BEAM_WIDTH
    worse = np.diff(distance[chosen]) > 0.0  # the later one of two
    dropped = np.zeros(len(chosen), dtype=bool)
    dropped[1:] = near & worse
    dropped[:-1] |= near & ~worse
    return chosen[~dropped]


def _time_offsets(times: NDArray[Any], stamp: float) -> Floats:
    """Return the seconds from the stamp to each point (n,); zeros if the times are of an unknown kind."""
    nanoseconds = times.dtype.kind in "iu" or bool(np.median(np.abs(times)) >= MIN_NANOSECONDS)
    offsets = times.astype(np.float64) * (1e-9 if nanoseconds else 1.0)
    if np.median(np.abs(offsets)) >= MIN_DATE:
        offsets -= stamp
    known = np.isfinite(offsets).all() and np.abs(offsets).max() <= MAX_DURATION
    return np.asarray(offsets if known else np.zeros(len(offsets)))
