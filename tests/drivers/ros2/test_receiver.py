"""Scans and odometry of ROS 2 arrive as messages, with what is missing named."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Odometry, Scan
from drivers.recordings.ros_encoder import RosEncoder
from drivers.recordings.ros_messages import LASER_SCAN, ODOMETRY, TRANSFORMS
from drivers.ros2 import silence as silence_module
from drivers.ros2.inputs import Inputs
from drivers.ros2.link import STATIC_TRANSFORMS, QoS
from drivers.ros2.receiver import MAX_WAITING_SCANS, NO_MOUNT, PAUSED, TOO_SLOW, RosReceiver
from drivers.ros2.stamp_check import Refusal
from drivers.timing.beam_times import BeamTimes

from ...memory_link import MemoryLink

MOUNT = np.array([0.1, -0.05, 1.0])
ENCODER = RosEncoder()


class Robot:
    """A robot that publishes on a link."""

    def __init__(self, link: MemoryLink, scan: str = "/scan") -> None:
        self._scan = link.publish(scan, LASER_SCAN, QoS())
        self._moving = link.publish("/tf", TRANSFORMS, QoS())
        self._fixed = link.publish("/tf_static", TRANSFORMS, STATIC_TRANSFORMS)
        self._odometry = link.publish("/odom", ODOMETRY, QoS())

    def scan(self, stamp: float, frame: str = "laser") -> None:
        beams = np.linspace(-1.0, 1.0, 5)
        self._scan(ENCODER.scan(Scan(stamp, beams + 2.0, beams, np.zeros(5), 0.1, 10.0), frame))

    def move(self, stamp: float, pose: se2.Pose, child: str = "base_footprint") -> None:
        self._moving(ENCODER.transform(stamp, "odom", child, pose))

    def mount(self, parent: str, child: str, pose: se2.Pose) -> None:
        self._fixed(ENCODER.transform(0.0, parent, child, pose))

    def odometry(self, stamp: float, pose: se2.Pose) -> None:
        self._odometry(ENCODER.odometry(Odometry(stamp, pose)))


@pytest.fixture
def link() -> MemoryLink:
    return MemoryLink()


@pytest.fixture
def robot(link: MemoryLink) -> Robot:
    return Robot(link)


def messages(receiver: RosReceiver) -> list[Scan | Odometry]:
    receiver.stop()
    found = []
    while (message := receiver.receive(0.0)) is not None:
        assert isinstance(message, Scan | Odometry)
        found.append(message)
    return found


def test_scan_and_transform_arrive_bit_for_bit(link: MemoryLink, robot: Robot) -> None:
    robot.mount("base_footprint", "laser", MOUNT)  # latched: before the node starts
    receiver = RosReceiver(link, Inputs())
    pose = np.array([0.1, 0.2, 0.3])
    robot.move(1.0, pose)
    robot.scan(0.9)
    odometry, scan = messages(receiver)
    assert isinstance(scan, Scan)
    assert odometry.stamp == 1.0
    assert np.array_equal(odometry.pose, pose)
    assert scan.stamp == 0.9
    assert np.array_equal(scan.mount, MOUNT)


def test_odometry_of_another_base_frame_is_moved(link: MemoryLink, robot: Robot) -> None:
    """TurtleBots publish odom -> base_footprint; base_link is fixed above it, here also beside it."""
    offset = np.array([0.2, 0.0, 0.5])
    robot.mount("base_footprint", "base_link", offset)
    robot.mount("base_link", "laser", MOUNT)
    receiver = RosReceiver(link, Inputs(base_frame="base_link"))
    robot.move(1.0, np.array([1.0, 2.0, 0.3]))
    robot.move(1.1, np.array([9.0, 9.0, 0.0]), child="elsewhere")
    robot.scan(1.0)
    odometry, scan = messages(receiver)
    assert isinstance(scan, Scan)
    assert odometry.pose == pytest.approx(se2.compose([1.0, 2.0, 0.3], offset))
    assert np.array_equal(scan.mount, MOUNT)


def test_odometry_messages_take_the_place_of_transforms(link: MemoryLink, robot: Robot) -> None:
    readings: list[Odometry] = []
    receiver = RosReceiver(link, Inputs(odometry="/odom"), readings.append)
    robot.move(1.0, np.zeros(3))
    robot.odometry(2.0, np.array([1.0, 0.0, 0.0]))
    assert messages(receiver) == readings
    assert [reading.stamp for reading in readings] == [2.0]


def test_beams_of_each_lidar_have_the_times_that_are_set(link: MemoryLink, robot: Robot) -> None:
    second = Robot(link, "/rear")
    robot.mount("base_footprint", "laser", MOUNT)
    turning = BeamTimes(0.2, reversed=True)
    receiver = RosReceiver(link, Inputs(second_scan="/rear", second_beam_times=turning))
    robot.scan(1.0)
    second.scan(1.0)
    first, other = messages(receiver)
    assert isinstance(first, Scan)
    assert isinstance(other, Scan)
    assert not first.time_offsets.any()
    np.testing.assert_allclose(other.time_offsets, 0.1 / np.pi * np.linspace(2.0, 0.0, 5), atol=1e-7)


def test_scans_wait_for_their_transform(link: MemoryLink, robot: Robot) -> None:
    receiver = RosReceiver(link, Inputs())
    robot.scan(1.0)
    assert receiver.missing() == ["no transform base_footprint -> laser; scans are dropped until there is one"]
    robot.mount("base_footprint", "laser", MOUNT)
    robot.scan(2.0)
    assert receiver.missing() == []
    assert [message.stamp for message in messages(receiver)] == [2.0]
    assert receiver.report.reasons == {NO_MOUNT: 1}


def test_missing_topics_are_named(link: MemoryLink, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(silence_module.time, "monotonic", lambda: now)
    receiver = RosReceiver(link, Inputs(mount_is_set=True))
    robot = Robot(link)
    robot.scan(1.0)
    robot.move(1.0, np.zeros(3))
    assert receiver.missing() == []
    now += silence_module.SILENCE + 1.0
    assert receiver.missing() == ["no scans on /scan", "no transform odom -> base_footprint on /tf"]
    robot.move(2.0, np.zeros(3), child="base_link")
    assert receiver.missing()[1].endswith("on /tf, but to base_link: is base_frame set correctly?")


def test_busy_consumer_loses_the_oldest_scans_and_no_odometry(link: MemoryLink, robot: Robot) -> None:
    receiver = RosReceiver(link, Inputs(mount_is_set=True))
    count = MAX_WAITING_SCANS + 10
    for stamp in range(1, count + 1):
        robot.move(float(stamp), np.zeros(3))
        robot.scan(float(stamp))
    found = messages(receiver)
    assert [message.stamp for message in found if isinstance(message, Scan)] == list(range(11, count + 1))
    assert len([message for message in found if isinstance(message, Odometry)]) == count
    assert receiver.report.reasons == {TOO_SLOW: 10}


def test_late_paused_and_damaged_messages_are_counted(link: MemoryLink, robot: Robot) -> None:
    receiver = RosReceiver(link, Inputs(mount_is_set=True))
    robot.scan(2.0)
    robot.scan(1.0)
    receiver.paused = True
    robot.scan(3.0)
    receiver.paused = False
    link.publish("/scan", LASER_SCAN, QoS())(b"\0\1\0\0abc")
    assert len(messages(receiver)) == 1
    damaged = "/scan: sensor_msgs/msg/LaserScan cannot be decoded"
    assert receiver.report.reasons == {Refusal.LATE: 1, PAUSED: 1, damaged: 1}


def test_clock_of_one_sensor_that_was_set_back_is_named(link: MemoryLink, robot: Robot) -> None:
    receiver = RosReceiver(link, Inputs(mount_is_set=True))
    robot.move(100.0, np.zeros(3))
    for stamp in (100.0, 1.0, 2.0, 3.0, 4.0):
        robot.scan(stamp)
    assert receiver.missing() == []
    robot.scan(5.0)
    robot.move(100.1, np.zeros(3))
    assert ["the clock of a sensor was set back" in line for line in receiver.missing()] == [True]
    assert not receiver.clock_was_set_back
    robot.scan(101.0)
    assert receiver.missing() == []


@pytest.mark.parametrize(("back", "begins_again"), [(90.0, True), (3.0, False)])
def test_a_clock_that_is_set_back_for_all_begins_again(
    link: MemoryLink, robot: Robot, back: float, begins_again: bool
) -> None:
    """A short time is waited for. The second sensor whose clock is older decides, whichever that is."""
    receiver = RosReceiver(link, Inputs(mount_is_set=True))
    for stamp in (99.0, 100.0):
        robot.scan(stamp)
        robot.move(stamp, np.zeros(3))
    for step in range(6):
        assert not receiver.clock_was_set_back
        robot.move(100.0 - back + 0.1 * step, np.zeros(3))
    robot.scan(100.0 - back)
    robot.move(100.7 - back, np.zeros(3))
    assert receiver.clock_was_set_back == begins_again
    receiver.begin_again()
    assert not receiver.clock_was_set_back
    robot.move(100.8 - back, np.zeros(3))
    robot.scan(100.8 - back)
    assert [message.stamp for message in messages(receiver)] == pytest.approx([100.8 - back] * 2)


@pytest.mark.parametrize("wrong", ["scan", "odometry"])
def test_a_single_stamp_far_ahead_is_dropped(link: MemoryLink, robot: Robot, wrong: str) -> None:
    receiver = RosReceiver(link, Inputs(mount_is_set=True))
    for stamp in (100.0, 100.1, 100.2):
        robot.move(86500.0 if (stamp, wrong) == (100.1, "odometry") else stamp, np.zeros(3))
        robot.scan(86500.0 if (stamp, wrong) == (100.1, "scan") else stamp)
    found = messages(receiver)
    lost = Odometry if wrong == "odometry" else Scan
    assert {one.stamp for one in found} == {100.0, 100.1, 100.2}
    assert [one.stamp for one in found if type(one) is lost] == [100.0, 100.2]
    assert receiver.report.reasons == {Refusal.OTHER_CLOCK: 1}


def test_a_clock_that_is_set_ahead_for_all_changes_nothing(link: MemoryLink, robot: Robot) -> None:
    receiver = RosReceiver(link, Inputs(mount_is_set=True))
    stamps = [100.0, 100.1, 3e7, 3e7 + 0.1, 3e7 + 0.2]
    for stamp in stamps:
        robot.move(stamp, np.zeros(3))
        robot.scan(stamp)
    assert receiver.missing() == []
    found = messages(receiver)
    assert [one.stamp for one in found if isinstance(one, Scan)] == stamps
    assert receiver.report.skipped == 1


def test_a_sensor_with_another_clock_is_named_and_dropped_until_its_clock_is_set(
    link: MemoryLink, robot: Robot
) -> None:
    receiver = RosReceiver(link, Inputs(mount_is_set=True))
    for step in range(10):
        robot.move(100.0 + 0.1 * step, np.zeros(3))
        robot.scan(160.0 + 0.1 * step)
    line = "the clock of a lidar is not that of odometry; its messages are dropped until it is"
    assert receiver.missing() == [line]
    robot.scan(101.0)
    assert receiver.missing() == []
    assert [one.stamp for one in messages(receiver) if isinstance(one, Scan)] == [101.0]


def test_odometry_that_is_stamped_before_simulated_time_begins_again(link: MemoryLink, robot: Robot) -> None:
    """A stamp of zero stands for the time of reception."""
    receiver = RosReceiver(link, Inputs(mount_is_set=True))
    robot.move(0.0, np.zeros(3))
    for step in range(5):
        assert not receiver.clock_was_set_back
        robot.move(0.02 * step + 0.02, np.zeros(3))
        robot.scan(0.02 * step + 0.02)
    assert receiver.clock_was_set_back
    receiver.begin_again()
    robot.move(0.3, np.zeros(3))
    robot.scan(0.3)
    assert [one.stamp for one in messages(receiver)] == [0.3, 0.3]


@pytest.mark.parametrize("silent", ["odometry", "scan", "both"])
def test_sensors_go_on_after_a_pause(link: MemoryLink, robot: Robot, silent: str) -> None:
    """Some bases send odometry only while they drive."""
    receiver = RosReceiver(link, Inputs(mount_is_set=True))
    for stamp in [*range(100, 120), 130]:
        pauses = {silent} if 102 < stamp < 130 else set()
        if not pauses & {"scan", "both"}:
            robot.scan(stamp)
        if not pauses & {"odometry", "both"}:
            robot.move(stamp, np.zeros(3))
    robot.scan(130.1)
    robot.move(130.1, np.zeros(3))
    last = messages(receiver)[-2:]
    assert [one.stamp for one in last] == [130.1, 130.1]
    assert receiver.report.skipped <= 1


def test_odometry_messages_of_another_frame_are_moved(link: MemoryLink, robot: Robot) -> None:
    """Their frame is base_link; that of the robot is fixed beside it. Frames that nothing connects are taken as it."""
    offset = np.array([0.2, 0.0, 0.5])
    receiver = RosReceiver(link, Inputs(odometry="/odom"))
    robot.odometry(1.0, np.array([1.0, 2.0, 0.3]))
    robot.mount("base_link", "base_footprint", offset)
    robot.odometry(2.0, np.array([1.0, 2.0, 0.3]))
    before, after = messages(receiver)
    assert isinstance(before, Odometry)
    assert isinstance(after, Odometry)
    assert np.array_equal(before.pose, [1.0, 2.0, 0.3])
    assert after.pose == pytest.approx(se2.compose([1.0, 2.0, 0.3], offset))


def test_scans_of_a_second_lidar_have_its_number_and_mount(link: MemoryLink, robot: Robot) -> None:
    behind = np.array([-0.2, 0.0, 3.0])
    robot.mount("base_footprint", "laser", MOUNT)
    robot.mount("base_footprint", "rear_laser", behind)
    receiver = RosReceiver(link, Inputs(second_scan="/rear/scan"))
    second = Robot(link, "/rear/scan")
    robot.scan(1.0)
    second.scan(0.98, "rear_laser")  # the order of the stamps is that of each lidar
    second.scan(0.97, "rear_laser")
    first, other = messages(receiver)
    assert isinstance(first, Scan)
    assert isinstance(other, Scan)
    assert (first.lidar, other.lidar) == (0, 1)
    assert np.array_equal(other.mount, behind)
    assert receiver.report.reasons == {Refusal.LATE: 1}


def test_a_missing_second_lidar_is_named(link: MemoryLink, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(silence_module.time, "monotonic", lambda: now)
    receiver = RosReceiver(link, Inputs(second_scan="/rear/scan", uses_odometry=False, mount_is_set=True))
    now += 10.0
    Robot(link).scan(1.0)
    assert receiver.missing() == ["no scans on /rear/scan"]
