"""A wheel base of the node: what it publishes, and which velocities of ROS 2 drive it."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from typing import ClassVar

import numpy as np
import pytest

from drivers.bases import Velocity
from drivers.devices.device_spec import parse_device
from drivers.devices.driving import DriveLimits
from drivers.devices.snapshot import Snapshot
from drivers.messages import Odometry
from drivers.recordings.ros_messages import ODOMETRY, TRANSFORMS, decode, planar_pose, planar_transform, type_store
from drivers.ros2 import wheel_base
from drivers.ros2.inputs import Inputs
from drivers.ros2.link import DEFAULT, QoS
from drivers.ros2.names import NodeNames
from drivers.ros2.receiver import RosReceiver
from drivers.ros2.selection import Backend, open_link
from drivers.ros2.wheel_base import TWIST, TWIST_STAMPED, BaseTopics, RosWheelBase

from ...memory_link import MemoryLink
from ..devices.device_peers import DRIVE, KINDS, WHEELS, BasePeer, plugged


def twist(speed: float, turn_rate: float, stamped: bool) -> bytes:
    store = type_store("cdr")
    types = dict(store.types)
    vector = types["geometry_msgs/msg/Vector3"]
    message = types[TWIST](vector(speed, 0.0, 0.0), vector(0.0, 0.0, turn_rate))
    if stamped:
        header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "base")
        message = types[TWIST_STAMPED](header, message)
    return bytes(store.serialize_cdr(message, TWIST_STAMPED if stamped else TWIST))


def wait_until(condition: Callable[[], bool], each: Callable[[], None] = lambda: None) -> None:
    end = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < end
        each()
        time.sleep(0.05)


@pytest.mark.parametrize("stamped", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_velocities_of_the_topic_drive_the_base_until_they_cease(stamped: bool) -> None:
    peer = KINDS["wheels"][0]()
    assert isinstance(peer, BasePeer)
    link, arrived = MemoryLink(), []

    def velocities() -> list[Velocity]:
        return [request for request in peer.requests if isinstance(request, Velocity)]

    with plugged(peer) as path:
        spec = parse_device(f"wheels:{path}?{WHEELS}")
        receiver = RosReceiver(link, Inputs(base=spec.text), arrived.append)
        with RosWheelBase(link, spec, BaseTopics(stamped=stamped), receiver, DriveLimits(0.3, 1.0)) as base:
            put = link.publish("/cmd_vel", TWIST_STAMPED if stamped else TWIST, DEFAULT)
            for useless in (b"", twist(np.nan, 0.0, stamped), twist(0.0, np.inf, stamped)):
                put(useless)
            wait_until(lambda: len(arrived) > 30)
            assert velocities() == []
            wait_until(lambda: bool(velocities()), lambda: put(twist(0.1, -0.2, stamped)))
            assert velocities()[-1] == Velocity(0.1, -0.2)
            wait_until(lambda: velocities()[-1] == Velocity(0.0, 0.0))
            wait_until(lambda: velocities()[-1] != Velocity(0.0, 0.0), lambda: put(twist(9.0, 0.0, stamped)))
            assert velocities()[-1] == Velocity(0.3, 0.0)
            receiver.stop()  # as Ctrl-C does
            wait_until(lambda: velocities()[-1] == Velocity(0.0, 0.0))
    assert base.failure is None
    readings = []
    while (message := receiver.receive(0.0)) is not None:
        readings.append(message)
    published = [decode(data, ODOMETRY, "cdr") for data in link.sent["/odom"]]
    assert {type(reading) for reading in readings} == {Odometry}
    assert readings == arrived
    assert (published[9].header.frame_id, published[9].child_frame_id) == ("odom", "base_footprint")
    assert planar_pose(published[9].pose.pose) == pytest.approx(readings[9].pose)
    speed = np.median([message.twist.twist.linear.x for message in published])
    assert speed == pytest.approx(10 * DRIVE.left / 0.02, rel=0.1)
    (transform,) = decode(link.sent["/tf"][9], TRANSFORMS, "cdr").transforms
    assert planar_transform(transform.transform) == pytest.approx(readings[9].pose)


class ReadBase:
    """An acquisition that delivers the readings of a base and ends."""

    snapshot = Snapshot(clock_offset=1000.0)

    driven: ClassVar[list[tuple[float, float]]] = []

    def __init__(self, *_: object, **__: object) -> None:
        self.readings = [Odometry(1000.0 + 0.02 * step, np.array([0.01 * step, 0.0, 0.0])) for step in range(40)]

    def __enter__(self) -> None: ...

    def stop(self) -> None: ...

    def close(self) -> None: ...

    @property
    def ended(self) -> bool:
        return not self.readings

    def receive(self, _: float) -> Odometry:
        return self.readings.pop(0)

    def drive(self, speed: float, turn_rate: float) -> None:
        self.driven.append((speed, turn_rate))


def test_odometry_follows_a_wall_clock_that_is_set_while_the_base_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scans of other nodes do, too."""
    offsets = iter([1000.0 + 0.001 * step + (1800.0 if step >= 20 else 0.0) for step in range(40)])
    monkeypatch.setattr(wheel_base, "Acquisition", ReadBase)
    monkeypatch.setattr(wheel_base, "wall_clock_offset", lambda: next(offsets))
    link, arrived = MemoryLink(), []
    receiver = RosReceiver(link, Inputs(base="kobuki"), arrived.append)
    with RosWheelBase(link, parse_device("kobuki:/dev/base"), BaseTopics(), receiver, None):
        wait_until(lambda: receiver.stopped)
    stamps = [decode(data, ODOMETRY, "cdr").header.stamp for data in link.sent["/odom"]]
    found = np.array([stamp.sec + stamp.nanosec * 1e-9 for stamp in stamps])
    assert found[:20] == pytest.approx(1000.0 + 0.02 * np.arange(20))
    assert found[20:] == pytest.approx(2800.02 + 0.02 * np.arange(20, 40))
    assert arrived[-1].stamp == pytest.approx(found[-1])
    speeds = [decode(data, ODOMETRY, "cdr").twist.twist.linear.x for data in link.sent["/odom"]]
    assert speeds[-1] == pytest.approx(0.5)


@pytest.mark.parametrize("reliable", [False, True])
def test_velocities_of_publishers_of_either_reliability_arrive(
    backend: Backend, monkeypatch: pytest.MonkeyPatch, reliable: bool
) -> None:
    """Joysticks and small boards often publish at best effort."""
    monkeypatch.setattr(wheel_base, "Acquisition", ReadBase)
    monkeypatch.setattr(ReadBase, "driven", [])
    with (
        closing(open_link(NodeNames(), backend)) as link,
        closing(open_link(NodeNames("joystick"), backend)) as joystick,
    ):
        receiver = RosReceiver(link, Inputs(base="kobuki"))
        RosWheelBase(link, parse_device("kobuki:/dev/base"), BaseTopics(), receiver, DriveLimits())
        put = joystick.publish("/cmd_vel", TWIST, QoS(reliable=reliable))
        wait_until(lambda: bool(ReadBase.driven), lambda: put(twist(0.1, -0.2, False)))
    assert set(ReadBase.driven) == {(0.1, -0.2)}


def test_nothing_listens_to_velocities_without_driving() -> None:
    link = MemoryLink()
    receiver = RosReceiver(link, Inputs(base="kobuki"))
    RosWheelBase(link, parse_device("kobuki:/dev/nothing"), BaseTopics(), receiver, None)
    assert "/cmd_vel" not in link.received
