"""Names follow the rules of ROS 2; the link is chosen by what is installed and by the robot's environment."""

from __future__ import annotations

import pytest

from drivers.errors import DriverError
from drivers.ros2 import selection
from drivers.ros2.names import NodeNames
from drivers.ros2.selection import Backend, choose_backend, domain_id, open_link


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("/scan", "/scan"),
        ("pose", "/robot/pose"),
        ("~/state", "/robot/slam_toolbox/state"),
        ("/tf", "/robot/tf"),
        ("map", "/shared/map"),
        ("odom", "/robot/slam_toolbox/odometry"),
    ],
)
def test_names_are_resolved_and_remapped(name: str, expected: str) -> None:
    rules = ["__ns:=/robot", "/tf:=tf", "map:=/shared/map", "/shared/map:=/never", "odom:=~/odometry"]
    names = NodeNames.from_rules(rules)
    assert names.resolve(name) == expected


def test_rules_of_launch_files_name_the_node() -> None:
    names = NodeNames.from_rules(["__node:=mapper", "__ns:=/", "mapper:scan:=front"])
    assert (names.qualified, names.resolve("scan")) == ("/mapper", "/front")


@pytest.mark.parametrize("rule", ["scan", "scan=/front", ":=x", "scan:=", "scan:=a b", "__node:=a/b", "__node:=/a"])
def test_invalid_rules_are_named(rule: str) -> None:
    with pytest.raises(DriverError, match="remapping"):
        NodeNames.from_rules([rule])


@pytest.mark.parametrize(
    ("installed", "rmw", "chosen"),
    [
        ({"rclpy", "zenoh", "cyclonedds"}, "rmw_zenoh_cpp", Backend.RCLPY),
        ({"zenoh", "cyclonedds"}, "rmw_zenoh_cpp", Backend.ZENOH),
        ({"zenoh", "cyclonedds"}, "rmw_fastrtps_cpp", Backend.DDS),
        ({"zenoh", "cyclonedds"}, "", Backend.DDS),
        ({"zenoh"}, "", Backend.ZENOH),
    ],
)
def test_link_is_chosen(monkeypatch: pytest.MonkeyPatch, installed: set[str], rmw: str, chosen: Backend) -> None:
    monkeypatch.setattr(selection, "find_spec", lambda name: name if name in installed else None)
    assert choose_backend({"RMW_IMPLEMENTATION": rmw}) is chosen


def test_missing_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(selection, "find_spec", lambda name: None)
    with pytest.raises(DriverError, match=r"RMW_IMPLEMENTATION=rmw_zenoh_cpp: pip install 'wclm-slam\[ros2\]'"):
        choose_backend({"RMW_IMPLEMENTATION": "rmw_zenoh_cpp"})
    with pytest.raises(DriverError, match="cyclonedds is not installed"):
        open_link(NodeNames(), Backend.DDS)


def test_domain_is_that_of_the_environment() -> None:
    assert domain_id({}) == 0
    assert domain_id({"ROS_DOMAIN_ID": "42"}) == 42
    for text in ("-1", "233", "two", 5000 * "1"):
        with pytest.raises(DriverError, match=f"ROS_DOMAIN_ID={text[:100]}"):
            domain_id({"ROS_DOMAIN_ID": text})
