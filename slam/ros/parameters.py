"""Parameters of the node, with the names of slam_toolbox where the meaning is the same."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationError, field_validator

from drivers.ros2.names import NAME

from ..bounds import MAX_LENGTH, MAX_PERIOD
from ..config import Settings
from ..errors import ConfigurationError


def _is_topic(name: str) -> str:
    if name and not NAME.fullmatch(name):
        raise ValueError("must be a name of ROS 2, such as /front/scan")
    return name


Topic = Annotated[str, AfterValidator(_is_topic)]
Length = Annotated[float, Field(ge=-MAX_LENGTH, le=MAX_LENGTH)]
Seconds = Annotated[float, Field(ge=0, le=MAX_PERIOD)]


class NodeParameters(Settings):
    """Parameters of the node; the defaults are those of slam_toolbox."""

    odom_frame: str = Field("odom", min_length=1, description="frame of the odometry")
    map_frame: str = Field("map", min_length=1, description="frame of the map")
    base_frame: str = Field("base_footprint", min_length=1, description="frame of the robot's base")
    scan_topic: Topic = Field("/scan", min_length=1, description="topic with the scans")
    cloud_topic: Topic = Field(
        "",
        description="topic with point clouds (sensor_msgs/msg/PointCloud2) that are cut at the setting "
        "lidar.cut_height, instead of scan_topic; empty: none",
    )
    second_scan_topic: Topic = Field("", description="topic with the scans of a second lidar; empty: there is none")
    odom_topic: Topic = Field(
        "", description="topic of type nav_msgs/msg/Odometry; by default the transform odom_frame -> base_frame on /tf"
    )
    imu_topic: Topic = Field("", description="topic of type sensor_msgs/msg/Imu, whose yaw rate is used; empty: none")
    map_name: Topic = Field("/map", min_length=1, description="topic of the occupancy grid")
    mode: Literal["mapping", "localization"] = Field(
        "mapping", description="continue the map of map_file_name, or only localise in it"
    )
    map_file_name: str = Field("", description="output directory of an earlier run; empty: an empty map")
    map_start_pose: list[Length] = Field(
        [], description="rough pose [x, y, heading] of the base in the map of map_file_name; empty: it may be anywhere"
    )
    map_start_at_dock: bool = Field(False, description="the base is near the first pose in the map of map_file_name")
    resolution: float = Field(0.05, ge=0.001, lt=100, description="side of a cell of the grid, metres")
    max_laser_range: float = Field(
        float("inf"), gt=0, description="metres; longer beams are not drawn into the grid, but are used otherwise"
    )
    map_update_interval: float = Field(10.0, gt=0, le=MAX_PERIOD, description="seconds between two grids, at least")
    transform_publish_period: Seconds = Field(
        0.05, description="seconds of odometry between two transforms, at least; 0: no transforms"
    )
    transform_timeout: Seconds = Field(
        0.5, description="seconds by which the transform is stamped later than the last measurement"
    )
    throttle_scans: int = Field(1, ge=1, description="use every so many-th scan")
    enable_stamped_cmd_vel: bool = Field(
        False, description="velocities for --drive are of type TwistStamped instead of Twist, as Nav2's parameter says"
    )
    paused_new_measurements: bool = Field(False, description="start paused")
    do_loop_closing: bool | None = Field(None, description="the setting loop_closure.enabled")
    minimum_travel_distance: float | None = Field(
        None, gt=0, allow_inf_nan=False, description="metres, the setting mapping.keyframe_distance"
    )
    minimum_travel_heading: float | None = Field(
        None, gt=0, allow_inf_nan=False, description="radians, the setting mapping.keyframe_turn"
    )
    use_sim_time: bool = Field(False, description="no effect: all times are those of the messages")

    @field_validator("map_start_pose")
    @classmethod
    def _check_pose(cls, pose: list[float]) -> list[float]:
        if len(pose) not in (0, 3):
            raise ValueError("must have three numbers")
        return pose

    @property
    def without_effect(self) -> list[str]:
        """Names of the parameters that only matter with map_file_name, if that is not set and they are."""
        if self.map_file_name:
            return []
        names = {"mode": self.mode == "localization", "map_start_pose": self.map_start_pose}
        return [name for name, is_set in (*names.items(), ("map_start_at_dock", self.map_start_at_dock)) if is_set]

    def settings(self, resolve: Callable[[str], str] = str) -> list[str]:
        """Return the settings of the estimator that parameters set, as GROUP.KEY=VALUE.

        `resolve` returns the absolute name of a topic, which it has in a recording.
        """
        values = {
            "mapping.keyframe_distance": self.minimum_travel_distance,
            "mapping.keyframe_turn": self.minimum_travel_heading,
            "loop_closure.enabled": self.do_loop_closing,
        }
        settings = [f"{name}={str(value).lower()}" for name, value in values.items() if value is not None]
        if self.second_scan_topic:
            topics = {"lidar": self.cloud_topic or self.scan_topic, "second_lidar": self.second_scan_topic}
            settings += [f"{group}.topic={resolve(topic)}" for group, topic in topics.items()]
        return settings


WITHOUT_COUNTERPART = """
solver_plugin ceres_linear_solver ceres_preconditioner ceres_trust_strategy ceres_dogleg_type ceres_loss_function
debug_logging minimum_time_interval tf_buffer_duration stack_size_to_use enable_interactive_mode interactive_mode
use_scan_matching use_scan_barycenter scan_buffer_size scan_buffer_maximum_scan_distance scan_queue_size
link_match_minimum_response_fine link_scan_maximum_distance loop_search_maximum_distance
loop_match_minimum_chain_size loop_match_maximum_variance_coarse loop_match_minimum_response_coarse
loop_match_minimum_response_fine correlation_search_space_dimension correlation_search_space_resolution
correlation_search_space_smear_deviation loop_search_space_dimension loop_search_space_resolution
loop_search_space_smear_deviation distance_variance_penalty angle_variance_penalty fine_search_angle_offset
coarse_search_angle_offset coarse_angle_resolution minimum_angle_penalty minimum_distance_penalty
use_response_expansion position_covariance_scale yaw_covariance_scale
min_laser_range minimum_laser_range min_pass_through occupancy_threshold restamp_tf use_map_saver
use_lifecycle_manager localization_on_configure paused_processing lifelong_search_use_tree lifelong_minimum_score
lifelong_iou_match lifelong_node_removal_score lifelong_overlap_score_scale lifelong_constraint_multiplier
lifelong_nearby_penalty lifelong_candidates_scale autostart qos_overrides start_type_description_service
bond_disable_heartbeat_timeout
"""
IGNORED = frozenset(WITHOUT_COUNTERPART.split())
"""Parameters of slam_toolbox and of every ROS 2 node that have no counterpart; what they are for is not needed here."""


def parse_parameters(values: Mapping[str, Any], place: str) -> tuple[NodeParameters, list[str]]:
    """Return the parameters, and the names of those that are ignored because they have no counterpart.

    place  file or option that the values are from, for errors

    Raises ConfigurationError if a parameter is unknown or its value is invalid.
    """
    known = {name: value for name, value in values.items() if name not in IGNORED}
    try:
        return NodeParameters.model_validate(known), sorted(set(values) - set(known))
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        is_unknown = first["type"] == "extra_forbidden"
        reason = "no such parameter" if is_unknown else first["msg"].removeprefix("Value error, ")
        raise ConfigurationError(f"{place}: {name}: {reason[:1].lower()}{reason[1:]}") from error
