"""Who answers on a port, found out without harm.

The order matters. Listening comes first, then bases, lidars last: A5, with which RPLIDARs are asked, presses the
buttons of a Roomba that is awake, one of which is "clean". A Create that answered is put to sleep again and asked
nothing more. What the others are asked with means nothing to those that come later.
"""

from __future__ import annotations

from contextlib import suppress

from ..errors import DriverError, NoResponseError
from .device import Device
from .device_spec import DeviceSpec
from .ld06 import Ld06Device
from .ports import connect
from .registry import make_device
from .rplidar import RplidarDevice
from .scip import ScipDevice
from .wheel_base import PROBE_ORDER, WheelBaseDevice

WHEEL_BASE_TIMEOUT = 2.5
"""Seconds for bases; boards that restart when their port is opened take about two."""


def probe_candidates() -> list[tuple[str, Device]]:
    """All kinds of devices, those first that must be asked first."""
    return [
        ("ld06", Ld06Device({})),
        *((kind, WheelBaseDevice(kind, {})) for kind in PROBE_ORDER),
        ("scip", ScipDevice({})),
        ("rplidar", RplidarDevice({})),
    ]


def probe(path: str) -> str:
    """Who answers on a serial port, in a line for people; why nobody does, where the port cannot be opened."""
    for kind, device in probe_candidates():
        device.start_timeout = WHEEL_BASE_TIMEOUT
        spec = DeviceSpec(kind, path, {}, f"{kind}:{path}")
        try:
            return f"{_identify(spec, device)}  ->  {spec.text}"
        except NoResponseError:
            continue
        except DriverError as error:
            return str(error)
    return "nothing that is known answers"


def identify(spec: DeviceSpec) -> str:
    """What a device says that it is; raises NoResponseError where it is not there, PortError where its port is not."""
    return _identify(spec, make_device(spec))


def _identify(spec: DeviceSpec, device: Device) -> str:
    error: NoResponseError | None = None
    for baud in device.bauds:
        transport = connect(spec, spec.address, baud, device.dtr)
        try:
            device.identify(transport, baud)
            return device.identity
        except NoResponseError as failure:
            error = error or failure
        finally:
            with suppress(DriverError):
                transport.close()
    assert error is not None
    raise error
