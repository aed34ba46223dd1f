"""Scans from the stored messages of a lidar: LaserScans, the exact beams beside them, and layers of point clouds."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..messages import Floats, Scan
from .point_clouds import POINT_CLOUD, HeightCut, scan_of_cloud
from .ros_contents import Contents
from .ros_messages import (
    BEAMS,
    LASER_SCAN,
    LidarMount,
    decode,
    exact_scan_of,
    intensities_of,
    scan_of,
    stamp_of,
)
from .stored_messages import StoredMessage


def beams_topic(scan_topic: str) -> str:
    """Return the topic with the exact beams of the scans on a topic."""
    return f"{scan_topic}_beams"


@dataclass(slots=True)
class ScanConverter:
    """Conversion of the messages with scans of one topic, in the recording's order.

    contents   of the recording, with the lidar's mount
    topic      of the scans; None without any
    cut        layer of point clouds that becomes a scan
    per_metre  units of the topic's ranges in a metre
    no_return  smallest range, metres, that stands for a no-return
    """

    contents: Contents
    topic: str | None
    cut: HeightCut
    per_metre: float
    no_return: float
    _mounts: dict[str, LidarMount] = field(default_factory=dict)  # by frame
    _poses: dict[str, Floats | None] = field(default_factory=dict)  # on the base (4, 4), by frame of point clouds
    _beams: StoredMessage | None = None  # exact beams of the next scan

    def convert(self, stored: StoredMessage) -> Scan | None:
        """Return the scan of a message; None if it has none. Raises ValueError if it cannot be decoded."""
        if self.topic is None:
            return None
        if stored.msgtype == BEAMS and stored.topic == beams_topic(self.topic):
            self._beams = stored
        elif stored.msgtype == LASER_SCAN and stored.topic == self.topic:
            return self._laser_scan(stored)
        elif stored.msgtype == POINT_CLOUD and stored.topic == self.topic:
            return self._cloud_scan(stored)
        return None

    def _laser_scan(self, stored: StoredMessage) -> Scan:
        message = decode(stored.data, LASER_SCAN, stored.encoding)
        mount = self._mount(message.header.frame_id)
        beams, self._beams = self._beams, None
        if beams is None or beams.received != stored.received:
            scan = scan_of(message, stored.received, mount, self.per_metre)
            return replace(scan, ranges=np.where(scan.ranges < self.no_return, scan.ranges, np.nan))
        stamp = stamp_of(message.header, stored.received)
        scan = exact_scan_of(decode(beams.data, BEAMS, beams.encoding), stamp, mount.pose, self.per_metre)
        strengths = intensities_of(message)
        fits = strengths is not None and len(strengths) == len(scan.ranges)
        return replace(scan, intensities=strengths) if fits else scan

    def _cloud_scan(self, stored: StoredMessage) -> Scan:
        message = decode(stored.data, POINT_CLOUD, stored.encoding)
        frame = message.header.frame_id
        if frame not in self._poses:
            self._poses[frame] = self.contents.find_pose(frame)
        return scan_of_cloud(message, stored.received, self._poses[frame], self._mount(frame), self.cut)

    def _mount(self, frame: str) -> LidarMount:
        """Return the mount of the lidar with a frame."""
        if frame not in self._mounts:
            self._mounts[frame] = self.contents.find_mount(frame)
        return self._mounts[frame]
