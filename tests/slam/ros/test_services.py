"""Services of the node, called by another computer with names that no file can have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.recordings.ros_messages import type_store
from drivers.ros2.names import NodeNames
from slam.io.exports import Occupancy
from slam.io.sessions import read_session
from slam.ros.run_control import RunControl
from slam.ros.services import FAILURE, NodeServices

from ...memory_link import MemoryLink


class PausedReceiver:
    paused = True


@pytest.mark.parametrize("name", ["a\0b", "x" * 300])
def test_names_that_no_file_can_have_are_answered_and_change_nothing(tmp_path: Path, name: str) -> None:
    link, control, reports = MemoryLink(), RunControl(), list[str]()
    drawn = Occupancy(np.zeros((1, 1), dtype=np.int8), np.zeros(2), 1.0)
    NodeServices(
        link,
        NodeNames(),
        "map",
        PausedReceiver(),
        control,
        current_grid=lambda: (1.0, drawn),
        read_session=read_session,
        report=reports.append,
    )
    file = str(tmp_path / name)
    text = type_store("cdr").types["std_msgs/msg/String"](file)
    assert link.call("/slam_toolbox/save_map", name=text).result == FAILURE
    assert link.call("/slam_toolbox/serialize_map", filename=file).result == FAILURE
    link.call("/slam_toolbox/deserialize_map", filename=file, match_type=1)
    assert ["no file can have" in line for line in reports] == [True, True, True]
    assert control.pending is None
    assert list(tmp_path.iterdir()) == []
