"""Mapping with point clouds, in recordings and as a node of ROS 2."""

from __future__ import annotations

import numpy as np
import pytest

import drivers
from drivers.messages import GroundTruth, Message, Scan
from drivers.recordings.point_clouds import POINT_CLOUD, HeightCut, scan_of_cloud
from drivers.recordings.ros_encoder import RosEncoder
from drivers.recordings.ros_messages import TRANSFORMS, LidarMount, decode
from drivers.ros2.inputs import Inputs
from drivers.ros2.link import STATIC_TRANSFORMS, QoS
from drivers.ros2.receiver import RosReceiver
from slam import Slam
from slam.evaluation.metrics import score_reference
from slam.io.tum import Trajectory

from ..clouds import cloud_of_scan
from ..memory_link import MemoryLink

MOUNT = np.array([0.1, 0.0, 0.0])


def cut(message: Message) -> Message:
    """Replace a scan by the one that its cloud is cut to."""
    if not isinstance(message, Scan):
        return message
    cloud = decode(cloud_of_scan(message), POINT_CLOUD, "cdr")
    return scan_of_cloud(cloud, 0, None, LidarMount(message.mount), HeightCut())


def test_the_office_is_mapped_to_millimetres() -> None:
    drive = [cut(message) for message in drivers.open("sim:office?duration=15")]
    slam = Slam()
    for message in drive:
        slam.add(message)
    finished = slam.finish()
    truth = [message for message in drive if isinstance(message, GroundTruth)]
    reference = Trajectory(np.array([t.stamp for t in truth]), np.array([t.pose for t in truth]))
    assert score_reference(Trajectory(finished.stamps, finished.poses), reference).figures()["ate_rmse"] < 0.005
    assert not finished.summary["suspects"]


def test_the_node_receives_clouds_at_the_height() -> None:
    link, encoder = MemoryLink(), RosEncoder()
    fixed = link.publish("/tf_static", TRANSFORMS, STATIC_TRANSFORMS)
    receiver = RosReceiver(link, Inputs(cloud="/points", cut=HeightCut(0.25, 0.1)))
    publish = link.publish("/points", POINT_CLOUD, QoS())
    scan = next(message for message in drivers.open("sim:office?duration=1") if isinstance(message, Scan))
    publish(cloud_of_scan(scan))
    assert receiver.receive(0.0) is None
    fixed(encoder.transform(0.0, "base_footprint", "laser", MOUNT))
    publish(cloud_of_scan(scan))
    received = receiver.receive(0.0)
    assert isinstance(received, Scan)
    assert np.array_equal(received.mount, MOUNT)
    seen = np.isfinite(scan.ranges)
    backwards = np.roll(scan.ranges[seen], -1)  # the beam at -pi is rounded to pi
    assert received.ranges == pytest.approx(backwards, abs=1e-4)
    assert received.time_offsets[:-1] == pytest.approx(scan.time_offsets[seen][1:], abs=1e-4)
    assert "/scan" not in link.received
