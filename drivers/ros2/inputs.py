"""What a node receives from ROS 2: topics, frames, and what of it is used."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..recordings.point_clouds import HeightCut
from ..timing.beam_times import STATED, BeamTimes


@dataclass(frozen=True, slots=True)
class Inputs:
    """What a node receives, with absolute names of topics.

    odometry        topic of type Odometry; empty: odometry is on /tf
    base            name of the node's own wheel base, from which odometry comes; empty: it comes from topics
    uses_odometry   false if the robot has none, or it is ignored
    cloud           topic with point clouds that take the place of `scan`; empty: none
    cut             their layer that becomes a scan
    second_scan     topic with the scans of a second lidar; empty: there is none
    mount_is_set    true if the settings state the lidar's mount, so that no transform is needed; likewise
                    second_mount_is_set
    initial_pose    topic with poses that a user sets, of type PoseWithCovarianceStamped; empty: none
    imu             topic with a gyroscope's rates, of type Imu; empty: none
    throttle_scans  only every so many-th scan is used
    beam_times      times of the beams that a user has set; likewise second_beam_times
    """

    scan: str = "/scan"
    cloud: str = ""
    cut: HeightCut = field(default_factory=HeightCut)
    second_scan: str = ""
    odometry: str = ""
    base: str = ""
    transforms: str = "/tf"
    static_transforms: str = "/tf_static"
    odometry_frame: str = "odom"
    base_frame: str = "base_footprint"
    imu: str = ""
    initial_pose: str = ""
    map_frame: str = "map"
    mount_is_set: bool = False
    second_mount_is_set: bool = False
    throttle_scans: int = 1
    uses_odometry: bool = True
    beam_times: BeamTimes = STATED
    second_beam_times: BeamTimes = STATED

    @property
    def scan_topics(self) -> list[str]:
        """Topics of the lidars."""
        first = self.cloud or self.scan
        return [first, self.second_scan] if self.second_scan else [first]
