"""Identification of the device on a port, without harm.

The order matters: listening first, then wheel bases, lidars last. The byte A5, with which requests to RPLIDARs begin,
presses the buttons of a Roomba that is awake, one of which is "clean". A Create that has responded is put to sleep
again and receives nothing more. The requests to the other devices have no meaning for those probed later.
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
"""Seconds for wheel bases; boards that restart when their port is opened take about two."""


def probe_candidates() -> list[tuple[str, Device]]:
    """Return all kinds of devices in the order in which they must be probed."""
    return [
        ("ld06", Ld06Device({})),
        *((kind, WheelBaseDevice(kind, {})) for kind in PROBE_ORDER),
        ("scip", ScipDevice({})),
        ("rplidar", RplidarDevice({})),
    ]


def probe(path: str) -> str:
    """Return one line of text on the device at a serial port, or the reason why the port cannot be opened."""
    for kind, device in probe_candidates():
        device.start_timeout = WHEEL_BASE_TIMEOUT
        spec = DeviceSpec(kind, path, {}, f"{kind}:{path}")
        try:
            return f"{_identify(spec, device)}  ->  {spec.text}"
        except NoResponseError:
            continue
        except DriverError as error:
            return str(error)
    return "no known device responds"


def identify(spec: DeviceSpec) -> str:
    """Return the identity of a device; raises NoResponseError if it does not respond, PortError if its port cannot be
    opened.
    """
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
