"""`wclm ros`: SLAM as a node of ROS 2."""

from __future__ import annotations

from contextlib import closing, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import typer

from ..console import print_message
from ..device_options import MaxSpeedOption, MaxTurnRateOption, parse_device_options, parse_drive_options
from ..options import (
    ConfigOption,
    ContinueOption,
    DurationOption,
    LocalizeOption,
    NoOdometryOption,
    OverwriteOption,
    PlanLayerOption,
    PlanOption,
    PlanUnitOption,
    SetOption,
    StartOption,
)
from .ros_options import (
    DriveOption,
    LinkOption,
    LogLevelOption,
    OutOption,
    OwnBaseOption,
    ParameterFileOption,
    ParameterOption,
    RemapOption,
    ReviewOption,
    RosArgsOption,
)

if TYPE_CHECKING:
    from drivers.devices.device_spec import DeviceSpec
    from drivers.devices.driving import DriveLimits
    from drivers.ros2.inputs import Inputs
    from drivers.ros2.link import Link
    from drivers.ros2.names import NodeNames
    from drivers.ros2.wheel_base import RosWheelBase
    from drivers.timing.beam_times import BeamTimes

    from ...config import LidarConfig
    from ...ros.parameters import NodeParameters
    from ...run_setup import RunSetup
    from ..plan_input import PlanOptions
    from .ros_node import RosNode


class OwnBase(NamedTuple):
    """Wheel base of the node, and its limits if it is driven."""

    spec: DeviceSpec
    driving: DriveLimits | None


def ros(
    out: OutOption = None,
    link: LinkOption = None,
    params_file: ParameterFileOption = None,
    param: ParameterOption = None,
    remap: RemapOption = None,
    ros_args: RosArgsOption = False,
    log_level: LogLevelOption = None,
    base: OwnBaseOption = None,
    drive: DriveOption = False,
    max_speed: MaxSpeedOption = None,
    max_turn_rate: MaxTurnRateOption = None,
    duration: DurationOption = None,
    overwrite: OverwriteOption = False,
    no_odometry: NoOdometryOption = False,
    continued: ContinueOption = None,
    localized: LocalizeOption = None,
    plan: PlanOption = None,
    plan_unit: PlanUnitOption = None,
    plan_layer: PlanLayerOption = None,
    start_pose: StartOption = None,
    config: ConfigOption = None,
    settings: SetOption = None,
    review: ReviewOption = True,
) -> None:
    """Map online as a node of ROS 2, with the topics, parameters and services of slam_toolbox.

    ROS 2 need not be installed beside this package: `pip install 'wclm-slam[ros2]'`.

    Example: [bold]wclm ros --params-file mapper_params_online_async.yaml --out map[/bold]
    """
    from drivers.ros2.names import NodeNames
    from drivers.ros2.selection import open_link

    from ..plan_input import PlanOptions
    from ..setup_from_options import without_odometry

    names = NodeNames.from_rules(remap or ())
    parameters = _load_parameters(params_file or [], param or [], names)
    own_base = _parse_base(base, drive, max_speed, max_turn_rate, no_odometry, parameters)
    on_plan = PlanOptions(plan, plan_unit, plan_layer or ())
    start = _prepare(names, parameters, continued, localized, config, settings, start_pose, on_plan)
    if no_odometry:
        start = without_odometry(start, "--no-odometry")
    with closing(open_link(names, link)) as opened:
        services = "" if opened.serves_services else "; topics only, no services"
        print_message(f"node {names.qualified} by {opened.description}{services}")
        node = _start(opened, names, parameters, start, own_base)
        wheel_base = _open_base(opened, names, parameters, node, own_base)
        with wheel_base or nullcontext():
            lines = node.run(start, out, overwrite=overwrite, review=review, duration=duration)
    typer.echo("\n".join(lines))
    if wheel_base is not None and wheel_base.failure is not None:
        raise wheel_base.failure


def _load_parameters(files: list[Path], assignments: list[str], names: NodeNames) -> NodeParameters:
    from ...errors import ConfigurationError
    from ...ros.parameter_files import load_parameters
    from ...ros.parameters import parse_parameters

    place = ", ".join([*map(str, files), *(["--param"] if assignments else [])])
    parameters, ignored = parse_parameters(load_parameters(files, assignments, names.qualified), place)
    first, second = parameters.cloud_topic or parameters.scan_topic, parameters.second_scan_topic
    if second and names.resolve(second) == names.resolve(first):
        raise ConfigurationError(f"{place}: second_scan_topic: {second} is the topic of the first lidar, too")
    if ignored:
        print_message(f"parameters without a counterpart are ignored: {', '.join(ignored)}")
    if parameters.without_effect:
        print_message(f"without map_file_name these parameters have no effect: {', '.join(parameters.without_effect)}")
    if settings := parameters.settings(names.resolve):
        print_message(f"settings from parameters: {', '.join(settings)}")
    return parameters


def _prepare(
    names: NodeNames,
    parameters: NodeParameters,
    continued: Path | None,
    localized: Path | None,
    config: Path | None,
    settings: list[str] | None,
    start_pose: str | None,
    plan: PlanOptions,
) -> RunSetup:
    """Load the settings, and the session or the plan; options take precedence over parameters."""
    import numpy as np

    from ..setup_from_options import setup_from_options

    overrides = [*parameters.settings(names.resolve), *(settings or ())]
    if not parameters.map_file_name or continued or localized or plan.path:
        return setup_from_options(continued, localized, config, overrides, start_pose, plan)
    session = Path(parameters.map_file_name)
    continued, localized = (session, None) if parameters.mode == "mapping" else (None, session)
    start = setup_from_options(continued, localized, config, overrides, start_pose)
    if start.pose is None and parameters.map_start_pose:
        return replace(start, pose=np.array(parameters.map_start_pose))
    if start.pose is None and parameters.map_start_at_dock and start.resumed is not None:
        return replace(start, pose=start.resumed.first_pose)
    return start


def _parse_base(
    bases: list[str] | None,
    drive: bool,
    max_speed: float | None,
    max_turn_rate: float | None,
    no_odometry: bool,
    parameters: NodeParameters,
) -> OwnBase | None:
    """Return the base of the node with its limits; raises DriverError or BadParameter if the options do not fit."""
    specs = parse_device_options(None, bases) if bases else []
    driving = parse_drive_options(drive, max_speed, max_turn_rate, specs)
    if not specs:
        return None
    if len(specs) > 1:
        raise typer.BadParameter("a node has one base at most", param_hint="--base")
    if no_odometry or parameters.odom_topic:
        other = "--no-odometry" if no_odometry else "the parameter odom_topic"
        raise typer.BadParameter(f"cannot be used with {other}", param_hint="--base")
    return OwnBase(specs[0], driving)


def _open_base(
    link: Link, names: NodeNames, parameters: NodeParameters, node: RosNode, base: OwnBase | None
) -> RosWheelBase | None:
    """Advertise and subscribe to the topics of the base; the returned context reads and drives it."""
    if base is None:
        return None
    from drivers.ros2.wheel_base import BaseTopics, RosWheelBase

    topics = BaseTopics(
        transforms=names.resolve("/tf"),
        odometry=names.resolve("odom"),
        velocity=names.resolve("cmd_vel"),
        odometry_frame=parameters.odom_frame,
        base_frame=parameters.base_frame,
        stamped=parameters.enable_stamped_cmd_vel,
    )
    if base.driving is not None:
        limits = f"{base.driving.speed:g} m/s and {base.driving.turn_rate:g} rad/s at most"
        print_message(f"{base.spec.text} is driven by {topics.velocity} at {limits}")
    return RosWheelBase(link, base.spec, topics, node.receiver, base.driving)


def _inputs(names: NodeNames, parameters: NodeParameters, start: RunSetup, base: OwnBase | None) -> Inputs:
    from drivers.recordings.point_clouds import HeightCut
    from drivers.ros2.inputs import Inputs

    return Inputs(
        scan=names.resolve(parameters.scan_topic),
        cloud=names.resolve(parameters.cloud_topic) if parameters.cloud_topic else "",
        cut=HeightCut(start.config.lidar.cut_height, start.config.lidar.cut_thickness),
        second_scan=names.resolve(parameters.second_scan_topic) if parameters.second_scan_topic else "",
        odometry=names.resolve(parameters.odom_topic) if parameters.odom_topic else "",
        base="" if base is None else base.spec.text,
        imu=names.resolve(parameters.imu_topic) if parameters.imu_topic else "",
        initial_pose=names.resolve("/initialpose"),
        map_frame=parameters.map_frame,
        transforms=names.resolve("/tf"),
        static_transforms=names.resolve("/tf_static"),
        odometry_frame=parameters.odom_frame,
        base_frame=parameters.base_frame,
        uses_odometry=start.config.odometry.source == "wheels",
        mount_is_set=start.config.lidar.mount is not None,
        second_mount_is_set=start.config.second_lidar.mount is not None,
        throttle_scans=parameters.throttle_scans,
        beam_times=_beam_times(start.config.lidar),
        second_beam_times=_beam_times(start.config.second_lidar),
    )


def _beam_times(lidar: LidarConfig) -> BeamTimes:
    """Return the times of a lidar's beams, as set or as stated."""
    from drivers.timing.beam_times import STATED, set_beam_times

    return set_beam_times(lidar.beam_order, lidar.turn_period) or STATED


def _start(link: Link, names: NodeNames, parameters: NodeParameters, start: RunSetup, base: OwnBase | None) -> RosNode:
    """Advertise and subscribe to all topics, and offer the services."""
    from drivers.ros2.receiver import RosReceiver

    from ...ros.outputs import NodeOutputs, warm_up
    from ..compilation import compile_all
    from .ros_node import RosNode

    compile_all()
    warm_up()
    inputs = _inputs(names, parameters, start, base)
    outputs = NodeOutputs(link, names, parameters, predicts_odometry=not inputs.uses_odometry)
    receiver = RosReceiver(link, inputs, outputs.publish_pose)
    receiver.paused = parameters.paused_new_measurements
    node = RosNode(receiver, outputs)
    if link.serves_services:
        _serve(link, names, parameters, node)
    return node


def _serve(link: Link, names: NodeNames, parameters: NodeParameters, node: RosNode) -> None:
    from ...io.sessions import read_session
    from ...ros.services import NodeServices

    NodeServices(
        link,
        names,
        parameters.map_frame,
        node.receiver,
        node.control,
        current_grid=node.outputs.current_grid,
        read_session=read_session,
        report=print_message,
    )
