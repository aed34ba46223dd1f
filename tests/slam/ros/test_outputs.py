"""What the node publishes about the events of a run, without the run."""

from __future__ import annotations

import numpy as np

from drivers.messages import Odometry
from drivers.ros2.names import NodeNames
from slam.events import ScanTracked, StateChanged
from slam.ros.outputs import NodeOutputs
from slam.ros.parameters import NodeParameters

from ...memory_link import MemoryLink


def test_the_map_has_no_transform_before_the_robot_is_recognised_in_it() -> None:
    """Navigation waits for the transform; it would take a pose that is not known yet for the robot's."""
    link = MemoryLink()
    outputs = NodeOutputs(link, NodeNames(), NodeParameters())
    outputs.begin(None)

    def sent_after(stamp: float, state: str | None = None) -> tuple[int, int]:
        if state is not None:
            outputs.handle(StateChanged(stamp, state, None))
        before = len(link.sent["/tf"]), len(link.sent["/pose"])
        outputs.publish_pose(Odometry(stamp, np.array([stamp, 0.0, 0.0])))
        return len(link.sent["/tf"]) - before[0], len(link.sent["/pose"]) - before[1]

    outputs.handle(StateChanged(1.0, "LOST", None))
    outputs.handle(ScanTracked(1.0, np.zeros(3), np.array([1.0, 0.0, 0.0]), 0.9, 0))
    assert sent_after(1.1) == (0, 0)
    assert sent_after(2.0, "OK") == (1, 1)
    assert sent_after(3.0, "LOST") == (1, 0)  # as odometry leads on from the known pose
    outputs.end()
