"""From a spec to the device that it asks for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from .device import Device
from .ld06 import Ld06
from .rplidar import Rplidar
from .scip import Scip
from .specs import DeviceSpec
from .wheels import Base

LIDARS: Mapping[str, Callable[[Mapping[str, Any]], Device]] = {"rplidar": Rplidar, "ld06": Ld06, "scip": Scip}


def make_device(spec: DeviceSpec) -> Device:
    """The device, not yet connected."""
    return LIDARS[spec.kind](spec.options) if spec.is_lidar else Base(spec.kind, spec.options)
