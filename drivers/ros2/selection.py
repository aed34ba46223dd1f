"""Choice of the link to ROS 2 by what is installed and by the environment of the robot."""

from __future__ import annotations

import os
from collections.abc import Mapping
from enum import StrEnum
from importlib.util import find_spec

from ..errors import DriverError
from .link import Link
from .names import NodeNames

MAX_DOMAIN = 232
"""Largest number of a ROS 2 domain, from the range of ports. Origin: definition."""


class Backend(StrEnum):
    """Kinds of links."""

    RCLPY = "rclpy"
    ZENOH = "zenoh"
    DDS = "dds"


PACKAGES = {Backend.RCLPY: "rclpy", Backend.ZENOH: "zenoh", Backend.DDS: "cyclonedds"}
"""Python package that each kind needs."""
INSTALL = {
    Backend.RCLPY: "source the setup of ROS 2 first, for the same version of Python",
    Backend.ZENOH: "pip install 'wclm-slam[ros2]'",
    Backend.DDS: "pip install 'wclm-slam[ros2]'; there are wheels for x86_64",
}


def choose_backend(environment: Mapping[str, str] = os.environ) -> Backend:
    """Return the kind of link that reaches the robot's nodes; raises DriverError if none is installed.

    rclpy if ROS 2 is sourced, as it can do everything; else what RMW_IMPLEMENTATION names; else DDS, which is the
    default of ROS 2, else zenoh.
    """
    available = [kind for kind in Backend if find_spec(PACKAGES[kind]) is not None]
    rmw = environment.get("RMW_IMPLEMENTATION", "")
    wanted = [Backend.RCLPY, Backend.ZENOH if "zenoh" in rmw else Backend.DDS]
    if not rmw:
        wanted.append(Backend.ZENOH)
    for kind in wanted:
        if kind in available:
            return kind
    needed = f" for RMW_IMPLEMENTATION={rmw}" if rmw else ""
    raise DriverError(f"no way to ROS 2{needed}: {INSTALL[wanted[1]]}; or {INSTALL[Backend.RCLPY]}")


def domain_id(environment: Mapping[str, str] = os.environ) -> int:
    """Return the domain that ROS_DOMAIN_ID names, 0 without it; raises DriverError if it is invalid."""
    text = environment.get("ROS_DOMAIN_ID", "").strip() or "0"
    if not (text.isascii() and text.isdigit() and len(text) < 10) or int(text) > MAX_DOMAIN:
        raise DriverError(f"ROS_DOMAIN_ID={text}: must be a number from 0 to {MAX_DOMAIN}")
    return int(text)


def open_link(names: NodeNames, backend: Backend | None = None) -> Link:
    """Join ROS 2 as a node, by a kind of link or by the one that fits; raises DriverError if that is not possible."""
    domain, kind = domain_id(), backend or choose_backend()
    if find_spec(PACKAGES[kind]) is None:
        raise DriverError(f"{PACKAGES[kind]} is not installed: {INSTALL[kind]}")
    if kind is Backend.ZENOH:
        from .zenoh_link import ZenohLink

        return ZenohLink(names, domain)
    if kind is Backend.DDS:
        from .dds_link import DdsLink

        return DdsLink(domain)
    from .rclpy_link import RclpyLink

    return RclpyLink(names, domain)
