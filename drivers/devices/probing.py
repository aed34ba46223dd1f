"""Who answers on a port, found out without harm.

The order matters. Listening comes first, then bases, lidars last: A5, with which RPLIDARs are asked, presses the
buttons of a Roomba that is awake, one of which is "clean". A Create that answered is put to sleep again and asked
nothing more. What the others are asked with means nothing to those that come later.
"""

from __future__ import annotations

from contextlib import suppress

from ..errors import DriverError, NoAnswerError
from .device import Device
from .ld06 import Ld06
from .ports import connect
from .registry import make_device
from .rplidar import Rplidar
from .scip import Scip
from .specs import DeviceSpec
from .wheels import MOST_HARMLESS, Base

LISTEN = 2.5
"""Seconds for bases; boards that restart when their port is opened take about two."""


def candidates() -> list[tuple[str, Device]]:
    """All kinds of devices, those first that must be asked first."""
    return [
        ("ld06", Ld06({})),
        *((kind, Base(kind, {})) for kind in MOST_HARMLESS),
        ("scip", Scip({})),
        ("rplidar", Rplidar({})),
    ]


def probe(path: str) -> str:
    """Who answers on a serial port, in a line for people; why nobody does, where the port cannot be opened."""
    for kind, device in candidates():
        device.patience = LISTEN
        spec = DeviceSpec(kind, path, {}, f"{kind}:{path}")
        try:
            return f"{_identify(spec, device)}  ->  {spec.text}"
        except NoAnswerError:
            continue
        except DriverError as error:
            return str(error)
    return "nothing that is known answers"


def identify(spec: DeviceSpec) -> str:
    """What a device says that it is; raises NoAnswerError where it is not there, PortError where its port is not."""
    return _identify(spec, make_device(spec))


def _identify(spec: DeviceSpec, device: Device) -> str:
    error: NoAnswerError | None = None
    for baud in device.bauds:
        transport = connect(spec, spec.address, baud, device.dtr)
        try:
            device.identify(transport, baud)
            return device.identity
        except NoAnswerError as failure:
            error = error or failure
        finally:
            with suppress(DriverError):
                transport.close()
    assert error is not None
    raise error
