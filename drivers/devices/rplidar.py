"""RPLIDARs of all models: identified at any baud rate, started in their typical mode, and stopped."""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping
from contextlib import suppress
from typing import Any, TypeVar

from ..errors import DriverError, NoResponseError
from ..lidars.rplidar import modes as scan_modes
from ..lidars.rplidar import requests
from ..lidars.rplidar.decoding import SIZES, decoder_for
from ..lidars.rplidar.models import BAUDS, DEFAULT_PWM, DEFAULT_SPEED, UNKNOWN, Motor, model_of, name_of
from ..lidars.rplidar.requests import Request
from ..lidars.rplidar.responses import (
    DEFAULT_SAMPLE_RATE,
    Health,
    HealthStatus,
    Info,
    ResponseReader,
    ResponseType,
    SampleRate,
    has_motor_pwm,
)
from ..transport import Received, Transport
from .device import await_response, drain
from .lidar import LidarDevice, LidarStream

RESPONSE_TIMEOUT = 0.3
"""Seconds; a device that listens responds within some milliseconds."""
MAX_TRIES = 3
MAX_RESPONSES = 5
"""Responses of which two must agree. On a line that damages a byte in a thousand, one of 33 responses of 30 bytes is
damaged, and four of five are once in 200 000 times.
"""
MOTOR_BOARD_SIZE = 4
"""Bytes of the response that tells if the motor's speed can be set."""
SCAN_TIMEOUT = 3.0
"""Seconds; some models respond to a scan request only when the head turns steadily."""
REBOOT_TIMEOUT = 15.0
"""Seconds that a device may take to restart after a reset; most take one."""
STOP_PAUSE = 0.1
"""Seconds between STOP and the next request; the documented millisecond is too short for many devices."""
FIRMWARE_WITH_SAMPLE_RATE = (1, 17)
PACKET_SAMPLES = {
    ResponseType.STANDARD: 1,
    ResponseType.EXPRESS: 32,
    ResponseType.HQ: 96,
    ResponseType.ULTRA: 96,
    ResponseType.DENSE: 40,
    ResponseType.ULTRA_DENSE: 64,
}

Result = TypeVar("Result")


class RplidarDevice(LidarDevice):
    """An RPLIDAR. Options: see `device_spec`; `mode` is the name of a scan mode, or "typical"."""

    bauds = BAUDS
    start_timeout = 10.0

    def __init__(self, options: Mapping[str, Any]) -> None:
        super().__init__(options)
        self._info: Info | None = None
        self._motor = Motor.SCAN
        self._has_pwm = False

    def identify(self, transport: Transport, baud: int) -> None:
        """Stop any scan and query the device's identity."""
        transport.set_dtr(False)
        transport.write(requests.STOP.packet())
        drain(transport)
        self._info = info = _info(transport, MAX_TRIES)
        self._motor = model_of(info.model).motor
        major, minor = info.firmware
        self.serial = info.serial
        self.identity = f"RPLIDAR {name_of(info.model)}, firmware {major}.{minor:02d}, serial number {info.serial}"
        self.check_serial(transport)

    def halt(self, transport: Transport) -> None:
        """Stop the scan, then the motor."""
        transport.write(requests.STOP.packet())
        time.sleep(STOP_PAUSE)
        if self._motor is Motor.SPEED:
            transport.write(requests.set_motor_speed(0).packet())
        elif self._motor is Motor.PWM and self._has_pwm:
            transport.write(requests.set_motor_pwm(0).packet())
        elif self._motor is Motor.DTR:
            transport.set_dtr(True)
        time.sleep(STOP_PAUSE)

    def start_stream(self, transport: Transport, baud: int) -> LidarStream:
        """Start the motor and a scan in the mode that the options name."""
        assert self._info is not None
        self._reset_if_failed(transport)
        model = model_of(self._info.model)
        modes = self._query_modes(transport, model.range_max)
        mode = modes.choose(self._options.get("mode", "typical"))
        self._start_motor(transport)
        # A pseudo terminal or a network accepts any baud rate; then the device's own port determines the delay.
        baud_is_physical = model is UNKNOWN or baud in model.bauds
        decoder = decoder_for(
            mode.response_type, mode.sample_period, baud if baud_is_physical else model.bauds[0], model.triangulates
        )
        remainder = _start_scan(transport, mode.start(), mode.response_type)
        samples = PACKET_SAMPLES[ResponseType(mode.response_type)]
        self.identity += f", mode {mode.name}"
        limits = (model.range_min, mode.max_distance or model.range_max)
        return LidarStream(
            decoder, samples * mode.sample_period, SIZES[ResponseType(mode.response_type)], limits, remainder=remainder
        )

    def _reset_if_failed(self, transport: Transport) -> None:
        """Reset a device that reports an error; raises DriverError if the error persists."""
        health = _health(transport)
        if health.status is not HealthStatus.ERROR:
            return
        transport.write(requests.RESET.packet())
        end = time.monotonic() + REBOOT_TIMEOUT
        while True:
            time.sleep(0.5)
            drain(transport)  # it sends lines of text after a restart
            try:
                _info(transport, 1)
                break
            except NoResponseError:
                if time.monotonic() > end:
                    raise
        health = _health(transport)
        if health.status is HealthStatus.ERROR:
            raise DriverError(f"{transport.name}: the lidar reports error {health.code}, also after a reset")

    def _query_modes(self, transport: Transport, max_distance: float) -> scan_modes.Modes:
        assert self._info is not None
        if scan_modes.reports_modes(self._info):
            return _run_query(transport, scan_modes.query_modes())
        rate = DEFAULT_SAMPLE_RATE
        if self._info.firmware >= FIRMWARE_WITH_SAMPLE_RATE:
            payload = _request(transport, requests.GET_SAMPLE_RATE, ResponseType.SAMPLE_RATE, SampleRate.SIZE)
            rate = SampleRate.parse(payload)
        return scan_modes.legacy_modes(rate, max_distance)

    def _start_motor(self, transport: Transport) -> None:
        """Start the motor if a scan does not start it, at the speed that the device requests."""
        assert self._info is not None
        speed, duty = DEFAULT_SPEED, DEFAULT_PWM
        if self._motor in (Motor.SPEED, Motor.PWM) and scan_modes.reports_modes(self._info):
            with suppress(NoResponseError):  # firmware with scan modes, but without this entry
                speed, duty = _run_query(transport, scan_modes.query_rotation())
        if self._motor is Motor.SPEED:
            transport.write(requests.set_motor_speed(speed).packet())
        elif self._motor is Motor.PWM:
            self._has_pwm = has_motor_pwm(
                _request(transport, requests.GET_MOTOR_BOARD, ResponseType.MOTOR_BOARD, MOTOR_BOARD_SIZE)
            )
            if self._has_pwm:
                transport.write(requests.set_motor_pwm(duty).packet())


def _request(
    transport: Transport,
    request: Request,
    type: ResponseType,
    size: int | None = None,
    prefix: bytes = b"",
    tries: int = MAX_TRIES,
) -> bytes:
    """Send a request and return the payload of its response; for type, size and prefix see `ResponseReader`.

    Responses have no checksum, so the request is repeated until two of them agree. Raises NoResponseError if the device
    does not respond `tries` times, and DriverError if it responds MAX_RESPONSES times and no two of them agree.
    """
    payloads: list[bytes] = []
    while len(payloads) < MAX_RESPONSES:
        transport.write(request.packet())
        found = await_response(transport, ResponseReader(type, size, prefix=prefix).feed, RESPONSE_TIMEOUT)
        if found is None:
            tries -= 1
            if not tries:
                raise NoResponseError(
                    transport.name, "no RPLIDAR responds here; is it powered, and the baud rate right?"
                )
        elif found[0] in payloads:
            return found[0]
        else:
            payloads.append(found[0])
    raise DriverError(f"{transport.name}: the lidar responds differently each time; is the cable damaged?")


def _info(transport: Transport, tries: int) -> Info:
    return Info.parse(_request(transport, requests.GET_INFO, ResponseType.INFO, Info.SIZE, tries=tries))


def _health(transport: Transport) -> Health:
    return Health.parse(_request(transport, requests.GET_HEALTH, ResponseType.HEALTH, Health.SIZE))


def _run_query(transport: Transport, query: Generator[Request, bytes, Result]) -> Result:
    """Send the requests that a generator yields, and return its result."""
    try:
        request = next(query)
        while True:
            prefix = scan_modes.echo(request)
            request = query.send(_request(transport, request, ResponseType.CONFIGURATION, prefix=prefix))
    except StopIteration as end:
        result: Result = end.value
        return result


def _start_scan(transport: Transport, request: Request, response_type: int) -> Received:
    """Start scanning; return the first bytes of the stream."""
    transport.write(request.packet())
    reader = ResponseReader(response_type, multiple=True)
    found = await_response(transport, reader.feed, SCAN_TIMEOUT)
    if found is None:
        raise NoResponseError(transport.name, "the RPLIDAR responds but does not start to scan")
    return Received(reader.remainder, found[1])
