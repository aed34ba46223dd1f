"""`wclm ros`: SLAM as a node of ROS 2."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drivers.ros2.selection import Backend

from ..console import print_message
from ..options import (
    ConfigOption,
    ContinueOption,
    DurationOption,
    LocalizeOption,
    NoOdometryOption,
    OverwriteOption,
    SetOption,
    StartOption,
)

if TYPE_CHECKING:
    from drivers.ros2.link import Link
    from drivers.ros2.names import NodeNames
    from drivers.ros2.receiver import Inputs

    from ...ros.parameters import NodeParameters
    from ..slam_run import RunSetup
    from .ros_node import RosNode


def ros(
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Output directory, as of `wclm run`; by default nothing is written."),
    ] = None,
    link: Annotated[
        Backend | None,
        typer.Option("--link", help="How to reach ROS 2; by default the one that is installed and fits the robot."),
    ] = None,
    params_file: Annotated[
        list[Path] | None,
        typer.Option("--params-file", metavar="FILE.yaml", help="Parameters, also those of slam_toolbox; repeatable."),
    ] = None,
    param: Annotated[
        list[str] | None, typer.Option("--param", "-p", metavar="NAME:=VALUE", help="One parameter; repeatable.")
    ] = None,
    remap: Annotated[
        list[str] | None,
        typer.Option("--remap", "-r", metavar="FROM:=TO", help="Topic, service, __ns or __node; repeatable."),
    ] = None,
    ros_args: Annotated[
        bool, typer.Option("--ros-args", help="No effect; launch files put it before the options above.")
    ] = False,
    duration: DurationOption = None,
    overwrite: OverwriteOption = False,
    no_odometry: NoOdometryOption = False,
    continued: ContinueOption = None,
    localized: LocalizeOption = None,
    start_pose: StartOption = None,
    config: ConfigOption = None,
    settings: SetOption = None,
    review: Annotated[bool, typer.Option("--review/--no-review", help="With --out: write the review log.")] = True,
) -> None:
    """Map online as a node of ROS 2, with the topics, parameters and services of slam_toolbox.

    ROS 2 need not be installed beside this package: `pip install wclm-slam[ros2]`.

    Example: [bold]wclm ros --params-file mapper_params_online_async.yaml --out map[/bold]
    """
    from drivers.ros2.names import NodeNames
    from drivers.ros2.selection import open_link

    from ..slam_run import without_odometry

    names = NodeNames.from_rules(remap or ())
    parameters = _load_parameters(params_file or [], param or [], names)
    start = _prepare(parameters, continued, localized, config, settings, start_pose)
    if no_odometry:
        start = without_odometry(start, "--no-odometry")
    with closing(open_link(names, link)) as opened:
        services = "" if opened.serves_services else "; topics only, no services"
        print_message(f"node {names.qualified} by {opened.description}{services}")
        node = _start(opened, names, parameters, start)
        lines = node.run(start, out, overwrite=overwrite, review=review, duration=duration)
    typer.echo("\n".join(lines))


def _load_parameters(files: list[Path], assignments: list[str], names: NodeNames) -> NodeParameters:
    from ...ros.parameter_files import load_parameters
    from ...ros.parameters import parse_parameters

    place = ", ".join([*map(str, files), *(["--param"] if assignments else [])])
    parameters, ignored = parse_parameters(load_parameters(files, assignments, names.qualified), place)
    if ignored:
        print_message(f"parameters without a counterpart are ignored: {', '.join(ignored)}")
    if parameters.settings():
        print_message(f"settings from parameters: {', '.join(parameters.settings())}")
    return parameters


def _prepare(
    parameters: NodeParameters,
    continued: Path | None,
    localized: Path | None,
    config: Path | None,
    settings: list[str] | None,
    start_pose: str | None,
) -> RunSetup:
    """Load the settings and the session; options take precedence over parameters."""
    from ..slam_run import prepare_run

    if parameters.map_file_name and continued is None and localized is None:
        session = Path(parameters.map_file_name)
        continued, localized = (session, None) if parameters.mode == "mapping" else (None, session)
    return prepare_run(continued, localized, config, [*parameters.settings(), *(settings or ())], start_pose)


def _inputs(names: NodeNames, parameters: NodeParameters, start: RunSetup) -> Inputs:
    from drivers.ros2.receiver import Inputs

    return Inputs(
        scan=names.resolve(parameters.scan_topic),
        odometry=names.resolve(parameters.odom_topic) if parameters.odom_topic else "",
        imu=names.resolve(parameters.imu_topic) if parameters.imu_topic else "",
        initial_pose=names.resolve("/initialpose"),
        map_frame=parameters.map_frame,
        transforms=names.resolve("/tf"),
        static_transforms=names.resolve("/tf_static"),
        odometry_frame=parameters.odom_frame,
        base_frame=parameters.base_frame,
        uses_odometry=start.config.odometry.source == "wheels",
        mount_is_set=start.config.lidar.mount is not None,
        throttle_scans=parameters.throttle_scans,
    )


def _start(link: Link, names: NodeNames, parameters: NodeParameters, start: RunSetup) -> RosNode:
    """Advertise and subscribe to all topics, and offer the services."""
    from drivers.ros2.receiver import RosReceiver

    from ...ros.outputs import NodeOutputs, warm_up
    from ..compilation import compile_all
    from .ros_node import RosNode

    compile_all()
    warm_up()
    inputs = _inputs(names, parameters, start)
    outputs = NodeOutputs(link, names, parameters, predicts_odometry=not inputs.uses_odometry)
    receiver = RosReceiver(link, inputs, outputs.publish_transform)
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
