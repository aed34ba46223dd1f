"""Parameter files of slam_toolbox and of launch files are read; mistakes are named in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from slam.errors import ConfigurationError
from slam.ros.parameter_files import load_parameters
from slam.ros.parameters import IGNORED, NodeParameters, parse_parameters

TURTLEBOT = """
slam_toolbox:
  ros__parameters:
    solver_plugin: solver_plugins::CeresSolver
    odom_frame: odom
    base_frame: base_footprint
    scan_topic: /scan
    mode: mapping #localization
    transform_publish_period: 0.02
    map_update_interval: 5.0
    transform_timeout: 0.2
    minimum_travel_distance: 0.5
    minimum_travel_heading: 0.25
    do_loop_closing: true
    loop_match_minimum_chain_size: 10
other_node:
  ros__parameters:
    odom_frame: wrong
"""


def written(folder: Path, text: str, name: str = "slam.yaml") -> Path:
    file = folder / name
    file.write_text(text)
    return file


def test_a_parameter_file_of_slam_toolbox_is_read(tmp_path: Path) -> None:
    values = load_parameters([written(tmp_path, TURTLEBOT)], ["use_sim_time:=true"], "/slam_toolbox")
    parameters, ignored = parse_parameters(values, "slam.yaml")
    assert parameters.transform_timeout == 0.2
    assert parameters.odom_frame == "odom"
    assert parameters.use_sim_time
    assert ignored == ["loop_match_minimum_chain_size", "solver_plugin"]
    assert parameters.settings() == [
        "mapping.keyframe_distance=0.5",
        "mapping.keyframe_turn=0.25",
        "loop_closure.enabled=true",
    ]


def test_files_of_launch_files_and_namespaces_are_read(tmp_path: Path) -> None:
    first = written(tmp_path, "/**:\n  ros__parameters:\n    map_frame: all\n    odom_frame: all\n", "a.yaml")
    second = written(tmp_path, "robot:\n  mapper:\n    ros__parameters:\n      odom_frame: mine\n", "b.yaml")
    assert load_parameters([first, second], ["map_frame:=last"], "/robot/mapper") == {
        "map_frame": "last",
        "odom_frame": "mine",
    }


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("slam_toolbox: [", "invalid YAML"),
        ("- 1", "must contain the name of a node"),
        ("amcl:\n  ros__parameters:\n    a: 1", "has parameters of /amcl, but not of /slam_toolbox"),
        ("slam_toolbox:\n  ros__parameters: 3", "must have names and values"),
        ("slam_toolbox: &node\n  inner: *node", "has aliases"),
        ("a: &a {x: 1}\n" + "".join(f"b{k}: &{chr(98 + k)} [*{chr(97 + k)}]\n" for k in range(20)), "has aliases"),
    ],
)
def test_damaged_files_are_named(tmp_path: Path, text: str, reason: str) -> None:
    with pytest.raises(ConfigurationError, match=f"slam.yaml: .*{reason}"):
        load_parameters([written(tmp_path, text)], [], "/slam_toolbox")
    with pytest.raises(ConfigurationError, match="No such file"):
        load_parameters([tmp_path / "missing.yaml"], [], "/slam_toolbox")


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"odom_fram": "odom"}, "odom_fram: no such parameter"),
        ({"resolution": -1.0}, "resolution: input should be greater"),
        ({"mode": "lifelong"}, "mode: input should be 'mapping' or 'localization'"),
        ({"map_start_pose": [1.0, 2.0]}, "map_start_pose: must have three numbers"),
        ({"map_start_pose": [1.0, 2.0, float("nan")]}, "map_start_pose.2: input should be"),
        ({"resolution": True}, "resolution: must not be true or false"),
        ({"throttle_scans": True}, "throttle_scans: must not be true or false"),
        ({"scan_topic": "front scan"}, "scan_topic: must be a name of ROS 2, such as /front/scan"),
        ({"imu_topic": "//imu"}, "imu_topic: must be a name of ROS 2"),
        ({"map_name": "1map"}, "map_name: must be a name of ROS 2"),
        ({"transform_timeout": 1e300}, "transform_timeout: input should be less than or equal to 1000000"),
        ({"map_update_interval": 1e300}, "map_update_interval: input should be less than or equal to 1000000"),
        ({"transform_timeout": "soon"}, "transform_timeout: input should be a valid number"),
    ],
)
def test_mistakes_are_named(values: dict[str, object], reason: str) -> None:
    with pytest.raises(ConfigurationError, match=f"^slam.yaml: {reason}"):
        parse_parameters(values, "slam.yaml")
    with pytest.raises(ConfigurationError, match=r"parameter 'a=1': must have the form NAME:=VALUE"):
        load_parameters([], ["a=1"], "/slam_toolbox")


def test_parameters_without_effect_are_known() -> None:
    pose = {"map_start_pose": [1.0, 2.0, 0.0], "map_start_at_dock": True, "mode": "localization"}
    assert parse_parameters(pose, "")[0].without_effect == ["mode", "map_start_pose", "map_start_at_dock"]
    assert parse_parameters({**pose, "map_file_name": "map"}, "")[0].without_effect == []
    assert parse_parameters({}, "")[0].without_effect == []


def test_two_lidars_have_topics_of_their_own(wclm: Any) -> None:
    arguments = ["--param", "second_scan_topic:=scan", "--duration", 0]
    wclm.refuses("ros", *arguments, because=["--param: second_scan_topic: scan is the topic of the first lidar, too"])


def test_page_lists_every_parameter() -> None:
    page = (Path(__file__).parents[3] / "docs" / "slam-toolbox.md").read_text(encoding="utf-8")
    assert not IGNORED & NodeParameters.model_fields.keys()
    for name in IGNORED | NodeParameters.model_fields.keys():
        assert f"`{name}`" in page, name
