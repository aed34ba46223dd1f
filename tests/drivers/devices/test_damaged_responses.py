"""An RPLIDAR on a line that damages bytes: its responses have no checksum."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

from drivers.devices.rplidar import RplidarDevice
from drivers.errors import DriverError
from drivers.lidars.rplidar.decoding import descriptor_of
from drivers.lidars.rplidar.modes import ConfigEntry, Modes, ScanMode, configuration_response
from drivers.lidars.rplidar.requests import Command, Request, RequestReader, get_configuration
from drivers.lidars.rplidar.responses import Descriptor, Health, HealthStatus, Info, ResponseType
from drivers.transport import Received

MODE = ScanMode(0, "DenseBoost", 1 / 9200.0, 40.0, ResponseType.DENSE)
BAUD = 256000
Damage = Callable[[Request, bytes, int], bytes]
"""Returns a damaged payload: of a request, its payload, and the number of responses to this request before."""


class DamagedLine:
    """A line to a lidar that responds at once."""

    name = "line"

    def __init__(self, damage: Damage) -> None:
        self._damage, self._reader, self._sent = damage, RequestReader(), b""
        self._counts: dict[bytes, int] = {}

    def read(self, timeout: float) -> Received:
        data, self._sent = self._sent, b""
        if not data:
            time.sleep(timeout)
        return Received(data, time.monotonic())

    def write(self, data: bytes) -> None:
        for request in self._reader.feed(data):
            if request.command == Command.EXPRESS_SCAN:
                self._sent += descriptor_of(MODE.response_type).packet()
            elif (response := respond(request)) is not None:
                count = self._counts.get(request.packet(), 0)
                self._counts[request.packet()] = count + 1
                kind, payload = response
                self._sent += Descriptor(len(payload), False, kind).packet() + self._damage(request, payload, count)

    def set_dtr(self, asserted: bool) -> bool:
        return True

    def pulse_rts(self, duration: float) -> bool:
        return True

    def cancel(self) -> None: ...

    def close(self) -> None: ...


def respond(request: Request) -> tuple[ResponseType, bytes] | None:
    """Return type and payload of a response; None if there is none."""
    if request.command == Command.GET_INFO:
        return ResponseType.INFO, Info(0x61, (1, 29), 7, "00112233445566778899AABBCCDDEEFF").payload()
    if request.command == Command.GET_HEALTH:
        return ResponseType.HEALTH, Health(HealthStatus.GOOD, 0).payload()
    if request.command == Command.GET_CONFIGURATION:
        payload = configuration_response(request, Modes((MODE,), 0))
        return None if payload is None else (ResponseType.CONFIGURATION, payload)
    return None


def flipped(payload: bytes, random: np.random.Generator) -> bytes:
    """Return a payload with one bit inverted."""
    place, bit = random.integers(len(payload)), random.integers(8)
    return payload[:place] + bytes([payload[place] ^ (1 << bit)]) + payload[place + 1 :]


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 5))])
def test_damaged_responses_are_not_believed(seed: int) -> None:
    """The first response to each request has a wrong bit; a wrong period of samples would stamp scans minutes late."""
    random = np.random.default_rng(seed)

    def damage(request: Request, payload: bytes, count: int) -> bytes:
        return payload if count else flipped(payload, random)

    device, line = RplidarDevice({}), DamagedLine(damage)
    device.identify(line, BAUD)
    stream = device.start_stream(line, BAUD)
    assert device.serial == "00112233445566778899AABBCCDDEEFF"
    assert stream.period == pytest.approx(40 * MODE.sample_period, rel=1e-4)
    assert stream.limits[1] == MODE.max_distance


def test_a_lidar_that_responds_differently_each_time_is_reported() -> None:
    period = get_configuration(ConfigEntry.SAMPLE_PERIOD, 0)

    def damage(request: Request, payload: bytes, count: int) -> bytes:
        return payload[:-1] + bytes([count]) if request.packet() == period.packet() else payload

    device, line = RplidarDevice({}), DamagedLine(damage)
    device.identify(line, BAUD)
    with pytest.raises(DriverError, match="line: the lidar responds differently each time; is the cable damaged"):
        device.start_stream(line, BAUD)
