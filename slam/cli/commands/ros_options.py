"""Options of `wclm ros` alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from drivers.ros2.selection import Backend

OutOption = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Output directory, as of `wclm run`; by default nothing is written."),
]
LinkOption = Annotated[
    Backend | None,
    typer.Option("--link", help="How to reach ROS 2; by default the one that is installed and fits the robot."),
]
ParameterFileOption = Annotated[
    list[Path] | None,
    typer.Option("--params-file", metavar="FILE.yaml", help="Parameters, also those of slam_toolbox; repeatable."),
]
ParameterOption = Annotated[
    list[str] | None, typer.Option("--param", "-p", metavar="NAME:=VALUE", help="One parameter; repeatable.")
]
RemapOption = Annotated[
    list[str] | None,
    typer.Option("--remap", "-r", metavar="FROM:=TO", help="Topic, service, __ns or __node; repeatable."),
]
RosArgsOption = Annotated[
    bool, typer.Option("--ros-args", help="No effect; launch files put it before the options above.")
]
LogLevelOption = Annotated[
    str | None, typer.Option("--log-level", metavar="LEVEL", help="No effect; launch files of Nav2 state it.")
]
OwnBaseOption = Annotated[
    list[str] | None,
    typer.Option("--base", metavar="SPEC", help="Wheel base of the node, whose odometry is published and used."),
]
DriveOption = Annotated[bool, typer.Option("--drive", help="Drive the base by the topic cmd_vel.")]
ReviewOption = Annotated[bool, typer.Option("--review/--no-review", help="With --out: write the review log.")]
