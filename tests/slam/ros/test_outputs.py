"""What the node publishes about the events of a run, without the run."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.messages import Odometry
from drivers.recordings.ros_messages import DIAGNOSTICS, decode
from drivers.ros2.encoder import Level
from drivers.ros2.names import NodeNames
from slam.events import ScanTracked, StateChanged
from slam.ros import outputs as outputs_module
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


def test_diagnostics_state_that_scans_are_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Odometry alone moves the pose then, and navigation is to stop."""
    link, now = MemoryLink(), 100.0
    monkeypatch.setattr(outputs_module.time, "monotonic", lambda: now)
    outputs = NodeOutputs(link, NodeNames(), NodeParameters())
    outputs.begin(None)

    def statuses() -> list[tuple[float, int, str]]:
        sent = [decode(data, DIAGNOSTICS, "cdr") for data in link.sent["/diagnostics"]]
        link.sent["/diagnostics"].clear()
        return [(one.header.stamp.sec, one.status[0].level, one.status[0].message) for one in sent]

    outputs.report_missing(["no scans on /scan"])  # nothing has arrived, so the time is unknown
    outputs.report_missing([])
    assert statuses() == []
    outputs.handle(ScanTracked(10.0, np.zeros(3), np.zeros(3), 0.9, 0))
    outputs.publish_pose(Odometry(17.0, np.zeros(3)))
    assert statuses() == [(10, Level.OK, "OK")]
    for _ in range(25):
        outputs.report_missing(["no scans on /scan"])
        now += 0.1
    assert statuses() == [(17, Level.WARN, "OK, no scans on /scan")] * 3
    outputs.report_missing([])
    assert statuses() == [(17, Level.OK, "OK")]
    outputs.end()
