"""`wclm ros` with a wheel base of its own: its odometry is used and published, and it follows cmd_vel."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.bases import Velocity
from drivers.messages import Scan
from drivers.recordings.ros_encoder import RosEncoder
from drivers.recordings.ros_messages import LASER_SCAN, TRANSFORMS
from drivers.ros2 import receiver, selection
from drivers.ros2.link import DEFAULT, STATIC_TRANSFORMS
from drivers.ros2.receiver import RosReceiver
from drivers.ros2.wheel_base import TWIST

from ...drivers.devices.device_peers import KINDS, BasePeer, plugged
from ...drivers.ros2.test_wheel_base import twist
from ...memory_link import MemoryLink


def scan_of_a_room(stamp: float) -> Scan:
    """Return a scan in the middle of a room of 6 m by 4 m."""
    angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    ranges = np.minimum(3.0 / np.abs(np.cos(angles)), 2.0 / np.maximum(np.abs(np.sin(angles)), 1e-9))
    return Scan(stamp, ranges, angles, np.linspace(0.0, 0.09, 360), 0.1, 20.0)


def wait_until(condition: Callable[[], bool], each: Callable[[], None] = lambda: None) -> None:
    end = time.monotonic() + 120.0
    while not condition():
        assert time.monotonic() < end
        each()
        time.sleep(0.1)


def test_the_node_maps_with_its_base_and_drives_it(monkeypatch: pytest.MonkeyPatch, wclm: Any, tmp_path: Path) -> None:
    link, opened, peer, encoder = MemoryLink(), [], KINDS["kobuki"][0](), RosEncoder()
    assert isinstance(peer, BasePeer)

    def open_receiver(*arguments: Any) -> RosReceiver:
        opened.append(RosReceiver(*arguments))
        return opened[-1]

    monkeypatch.setattr(selection, "open_link", lambda names, backend: link)
    monkeypatch.setattr(receiver, "RosReceiver", open_receiver)

    def velocities() -> list[Velocity]:
        return [request for request in peer.requests if isinstance(request, Velocity)]

    def use() -> None:
        mount = link.publish("/tf_static", TRANSFORMS, STATIC_TRANSFORMS)
        mount(encoder.transform(0.0, "base_footprint", "laser", np.zeros(3)))
        put_scan = link.publish("/scan", LASER_SCAN, DEFAULT)
        put_velocity = link.publish("/cmd_vel", TWIST, DEFAULT)
        wait_until(lambda: bool(link.sent["/odom"]))
        wait_until(lambda: len(link.sent["/pose"]) > 10, lambda: put_scan(encoder.scan(scan_of_a_room(now()), "laser")))
        wait_until(lambda: bool(velocities()), lambda: put_velocity(twist(0.1, 0.0, False)))
        opened[-1].stop()

    def now() -> float:
        return time.time() - 0.15

    with plugged(peer) as path:
        user = threading.Thread(target=use, daemon=True)
        user.start()
        result = wclm("ros", "--base", f"kobuki:{path}", "--drive", "--out", "map", "--no-review")
        user.join(60.0)
        wait_until(lambda: velocities()[-1] == Velocity(0.0, 0.0))  # the base may read it after the node has ended
    assert result.exit_code == 0, result.output
    assert f"wclm: kobuki:{path} is driven by /cmd_vel at 0.2 m/s and 1 rad/s at most" in result.stderr
    assert Velocity(0.1, 0.0) in velocities()
    assert (tmp_path / "map" / "trajectory.tum").is_file()


def test_a_missing_base_is_an_error_of_one_line(monkeypatch: pytest.MonkeyPatch, wclm: Any) -> None:
    monkeypatch.setattr(selection, "open_link", lambda names, backend: MemoryLink())
    result = wclm("ros", "--base", "kobuki:/dev/void")
    assert result.exit_code == 2
    assert result.stderr.splitlines()[1:] == ["wclm: /dev/void: no such port; is the device plugged in?"]
