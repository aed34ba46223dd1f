"""From a device spec to its device."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from .device import Device
from .device_spec import DeviceSpec
from .driving import BaseDriver
from .external_lidars import external_lidar
from .ld06 import Ld06Device
from .rplidar import RplidarDevice
from .scip import ScipDevice
from .wheel_base import WheelBaseDevice

LIDAR_DEVICES: Mapping[str, Callable[[Mapping[str, Any]], Device]] = {
    "rplidar": RplidarDevice,
    "ld06": Ld06Device,
    "scip": ScipDevice,
}


def make_device(spec: DeviceSpec, driver: BaseDriver | None = None) -> Device:
    """Create the device of a spec, not yet connected. A wheel base is driven by `driver`, if there is one."""
    if not spec.is_lidar:
        return WheelBaseDevice(spec.kind, spec.options, driver)
    device = LIDAR_DEVICES.get(spec.kind) or external_lidar(spec.kind)
    assert device is not None  # the spec was parsed
    return device(spec.options)
