"""Requests and responses of an RPLIDAR: known bytes, and both ends of the protocol together."""

from __future__ import annotations

import struct
from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import DriverError
from drivers.lidars.rplidar import decoding, models, modes, requests
from drivers.lidars.rplidar.modes import ConfigEntry, Modes, ScanMode
from drivers.lidars.rplidar.requests import Request, RequestReader
from drivers.lidars.rplidar.responses import (
    Descriptor,
    Health,
    HealthStatus,
    Info,
    ResponseReader,
    ResponseType,
    SampleRate,
    has_motor_pwm,
)

REQUESTS = [
    (requests.STOP, "A5 25"),
    (requests.RESET, "A5 40"),
    (requests.SCAN, "A5 20"),
    (requests.FORCE_SCAN, "A5 21"),
    (requests.GET_INFO, "A5 50"),
    (requests.GET_HEALTH, "A5 52"),
    (requests.GET_SAMPLE_RATE, "A5 59"),
    (requests.express_scan(0), "A5 82 05 00 00 00 00 00 22"),
    (requests.express_scan(1), "A5 82 05 01 00 00 00 00 23"),
    (requests.express_scan(2), "A5 82 05 02 00 00 00 00 20"),
    (requests.express_scan(3), "A5 82 05 03 00 00 00 00 21"),
    (requests.set_motor_speed(600), "A5 A8 02 58 02 55"),
    (requests.set_motor_speed(0), "A5 A8 02 00 00 0F"),
    (requests.set_motor_pwm(660), "A5 F0 02 94 02 C1"),
    (requests.set_motor_pwm(0), "A5 F0 02 00 00 57"),
    (requests.GET_MOTOR_BOARD, "A5 FF 04 00 00 00 00 5E"),
    (requests.get_configuration(ConfigEntry.TYPICAL), "A5 84 04 7C 00 00 00 59"),
    (requests.get_configuration(ConfigEntry.COUNT), "A5 84 04 70 00 00 00 55"),
    (requests.get_configuration(ConfigEntry.ROTATION), "A5 84 04 01 00 00 00 24"),
    (requests.get_configuration(ConfigEntry.SAMPLE_PERIOD, 1), "A5 84 06 71 00 00 00 01 00 57"),
    (requests.get_configuration(ConfigEntry.MAX_DISTANCE, 1), "A5 84 06 74 00 00 00 01 00 52"),
    (requests.get_configuration(ConfigEntry.RESPONSE_TYPE, 1), "A5 84 06 75 00 00 00 01 00 53"),
    (requests.get_configuration(ConfigEntry.NAME, 1), "A5 84 06 7F 00 00 00 01 00 59"),
]
A1 = Modes(
    (
        ScanMode(0, "Standard", 508e-6, 12.0, 0x81),
        ScanMode(1, "Express", 254e-6, 12.0, 0x82),
        ScanMode(2, "Boost", 127e-6, 12.0, 0x84),
        ScanMode(3, "Sensitivity", 127e-6, 12.0, 0x84),
        ScanMode(4, "Stability", 201e-6, 12.0, 0x84),
    ),
    typical=3,
)
BANNER = b"RP LIDAR System.\r\nFirmware Ver 1.25 - rc2, HW Ver 5\r\nModel: 18\r\n"


@pytest.mark.parametrize(("request_", "packet"), REQUESTS)
def test_requests_have_the_documented_bytes(request_: Request, packet: str) -> None:
    assert request_.packet() == bytes.fromhex(packet)


@settings(deadline=None)
@given(st.lists(st.sampled_from([r for r, _ in REQUESTS]), max_size=8), st.lists(st.integers(1, 9), min_size=1))
def test_requests_are_found_in_any_chunks(sent: list[Request], sizes: list[int]) -> None:
    data, reader, got = b"".join(request.packet() for request in sent), RequestReader(), []
    at = k = 0
    while at < len(data):
        size = sizes[k % len(sizes)]
        got += reader.feed(data[at : at + size])
        at, k = at + size, k + 1
    assert got == sent
    assert reader.bytes_skipped == 0


@settings(deadline=None)
@given(st.lists(st.binary(max_size=100), max_size=8))
def test_the_request_reader_accepts_any_bytes(chunks: list[bytes]) -> None:
    reader, whole = RequestReader(), RequestReader()
    got = [request for chunk in chunks for request in reader.feed(chunk)]
    assert got == whole.feed(b"".join(chunks))
    reader.feed(bytes(300))
    assert reader.feed(requests.STOP.packet())[-1:] == [requests.STOP]


def test_a_request_with_a_wrong_checksum_is_skipped() -> None:
    broken = bytearray(requests.set_motor_pwm(660).packet())
    broken[3] ^= 1
    reader = RequestReader()
    assert reader.feed(bytes(broken) + requests.GET_INFO.packet()) == [requests.GET_INFO]
    assert reader.bytes_skipped == 6


@pytest.mark.parametrize(
    ("packet", "size", "multiple", "type"),
    [
        ("A5 5A 14 00 00 00 04", 20, False, ResponseType.INFO),
        ("A5 5A 03 00 00 00 06", 3, False, ResponseType.HEALTH),
        ("A5 5A 04 00 00 00 15", 4, False, ResponseType.SAMPLE_RATE),
        ("A5 5A 05 00 00 40 81", 5, True, ResponseType.STANDARD),
        ("A5 5A 54 00 00 40 82", 84, True, ResponseType.EXPRESS),
        ("A5 5A 0D 03 00 40 83", 781, True, ResponseType.HQ),
        ("A5 5A 84 00 00 40 84", 132, True, ResponseType.ULTRA),
        ("A5 5A 54 00 00 40 85", 84, True, ResponseType.DENSE),
        ("A5 5A AA 00 00 40 86", 170, True, ResponseType.ULTRA_DENSE),
    ],
)
def test_descriptors_have_the_documented_bytes(packet: str, size: int, multiple: bool, type: ResponseType) -> None:
    descriptor = Descriptor.parse(bytes.fromhex(packet))
    assert descriptor == Descriptor(size, multiple, type)
    assert descriptor.packet() == bytes.fromhex(packet)
    if multiple:
        assert decoding.descriptor_of(type) == descriptor


@pytest.mark.parametrize("packet", ["", "A5 5A 14 00 00 00", "A5 5B 14 00 00 00 04", "A5 5A 14 00 00 C0 04"])
def test_invalid_descriptors_are_rejected(packet: str) -> None:
    with pytest.raises(DriverError, match="no response descriptor"):
        Descriptor.parse(bytes.fromhex(packet))


def test_the_identity_is_parsed_and_encoded() -> None:
    payload = bytes.fromhex("18 1D 01 07 92 D8 ED 93 C0 EA 98 C9 A5 E6 98 F2 07 06 46 69")
    info = Info.parse(payload)
    assert info == Info(24, (1, 29), 7, "92D8ED93C0EA98C9A5E698F207064669")
    assert info.payload() == payload
    assert models.name_of(info.model) == "A1M8"
    assert models.model_of(info.model) is models.A1


def test_the_health_is_parsed_and_encoded() -> None:
    assert Health.parse(bytes.fromhex("02 04 00")) == Health(HealthStatus.ERROR, 4)
    assert Health(HealthStatus.WARNING, 0x1234).payload() == bytes.fromhex("01 34 12")
    with pytest.raises(DriverError, match="health status 7"):
        Health.parse(bytes.fromhex("07 00 00"))


def test_sample_rates_and_motor_boards_are_parsed() -> None:
    assert SampleRate.parse(struct.pack("<HH", 476, 238)) == SampleRate(476e-6, 238e-6)
    assert SampleRate(476e-6, 238e-6).payload() == struct.pack("<HH", 476, 238)
    assert has_motor_pwm(bytes([1, 0, 0, 0]))
    assert not has_motor_pwm(bytes([2, 0, 0, 0]))
    with pytest.raises(DriverError, match="zero"):
        SampleRate.parse(bytes(4))


@settings(deadline=None)
@given(st.binary(max_size=40))
def test_any_payload_is_parsed_or_rejected(payload: bytes) -> None:
    for parse in (Info.parse, Health.parse, SampleRate.parse, has_motor_pwm, Descriptor.parse):
        with suppress(DriverError):
            parse(payload)


@pytest.mark.parametrize(
    "before",
    [
        b"",
        BANNER,
        b"\xa5",
        b"\xa5\x5a",
        bytes.fromhex("A5 5A 03 00 00 00 06 00 00 00"),
        b"\xa5\x5a\x54\x00\x00\x40\x85" * 9,
    ],
)
@settings(deadline=None)
@given(sizes=st.lists(st.integers(1, 30), min_size=1, max_size=5))
def test_a_response_is_found_after_any_bytes(before: bytes, sizes: list[int]) -> None:
    payload = bytes(range(20))
    data = before + Descriptor(20, False, ResponseType.INFO).packet() + payload + b"rest"
    reader = ResponseReader(ResponseType.INFO, Info.SIZE)
    at = k = 0
    got = None
    while got is None and at < len(data):
        got = reader.feed(data[at : at + sizes[k % len(sizes)]])
        at, k = at + sizes[k % len(sizes)], k + 1
    assert got == payload
    assert b"rest".startswith(reader.remainder)
    assert reader.bytes_skipped == len(before)


def test_the_remainder_begins_after_the_descriptor() -> None:
    reader = ResponseReader(ResponseType.DENSE, 84, multiple=True)
    assert reader.feed(b"noise\xa5\x5a\x54\x00\x00") is None
    assert reader.feed(b"\x40\x85first bytes") == b""
    assert reader.remainder == b"first bytes"


def test_a_response_to_another_request_is_skipped() -> None:
    request = requests.get_configuration(ConfigEntry.COUNT)
    reader = ResponseReader(ResponseType.CONFIGURATION, prefix=modes.echo(request))
    other = bytes.fromhex("7C 00 00 00 03 00")
    wanted = bytes.fromhex("70 00 00 00 05 00")
    for payload in (other, wanted):
        got = reader.feed(Descriptor(len(payload), False, ResponseType.CONFIGURATION).packet() + payload)
    assert got == wanted


@settings(deadline=None)
@given(st.lists(st.binary(max_size=200) | st.just(b"\xa5\x5a\x00\x02\x00\x00\x20"), max_size=20))
def test_the_response_reader_accepts_any_bytes_and_holds_few(chunks: list[bytes]) -> None:
    reader = ResponseReader(ResponseType.CONFIGURATION, prefix=b"\x70\0\0\0")
    fed = 0
    for chunk in chunks:
        if reader.feed(chunk) is not None:
            return
        fed += len(chunk)
        assert fed - reader.bytes_skipped <= 1024 + 7


def converse(known: Modes) -> Modes:
    """Query the modes of an emulated device."""
    query = modes.query_modes()
    request = next(query)
    while True:
        assert request.command == requests.Command.GET_CONFIGURATION
        payload = modes.configuration_response(request, known)
        assert payload is not None
        try:
            request = query.send(payload)
        except StopIteration as end:
            found: Modes = end.value
            return found


def test_modes_are_queried_from_the_device() -> None:
    found = converse(A1)
    assert found.typical == A1.typical
    for one, other in zip(found.modes, A1.modes, strict=True):
        assert (one.id, one.name, one.response_type) == (other.id, other.name, other.response_type)
        assert one.sample_period == pytest.approx(other.sample_period, rel=1e-4)
        assert one.max_distance == pytest.approx(other.max_distance)


def test_modes_are_chosen_by_name_or_default_to_typical() -> None:
    assert A1.choose().name == "Sensitivity"
    assert A1.choose("boost").id == 2
    assert A1.choose("Standard").start() == requests.SCAN
    assert A1.choose("Boost").start() == requests.express_scan(2)
    with pytest.raises(DriverError, match="no scan mode 'DenseBoost'; it has: Standard, Express, Boost, Sens"):
        A1.choose("DenseBoost")


@pytest.mark.parametrize(
    ("answer", "period"),
    [("71 00 00 00 00 FA 00 00", 250e-6), ("71 00 00 00 B2 6C 00 00", 108.695e-6)],
)
def test_sample_periods_are_converted_to_seconds(answer: str, period: float) -> None:
    query = modes.query_modes()
    next(query)
    query.send(b"\x70\0\0\0\x01\0")
    assert query.send(b"\x7c\0\0\0\x00\0") == requests.get_configuration(ConfigEntry.SAMPLE_PERIOD, 0)
    query.send(bytes.fromhex(answer))
    query.send(b"\x74\0\0\0" + struct.pack("<I", 40 * 256))
    query.send(b"\x75\0\0\0\x85")
    with pytest.raises(StopIteration) as end:
        query.send(b"\x7f\0\0\0DenseBoost\0")
    (mode,) = end.value.value.modes
    assert (mode.name, mode.max_distance, mode.response_type) == ("DenseBoost", 40.0, ResponseType.DENSE)
    assert mode.sample_period == pytest.approx(period, rel=1e-5)


@settings(deadline=None)
@given(st.lists(st.binary(max_size=12), min_size=1, max_size=10), st.booleans())
def test_any_response_to_a_mode_query_is_parsed_or_rejected(answers: list[bytes], echoed: bool) -> None:
    query = modes.query_modes()
    request = next(query)
    with suppress(DriverError, StopIteration):
        for answer in answers:
            request = query.send((modes.echo(request) if echoed else b"") + answer)


def test_old_firmware_has_two_modes() -> None:
    assert not modes.reports_modes(Info(24, (1, 23), 5, "00"))
    assert modes.reports_modes(Info(24, (1, 24), 5, "00"))
    assert modes.reports_modes(Info(0x61, (1, 2), 5, "00"))
    old = modes.legacy_modes(SampleRate(476e-6, 238e-6), 12.0)
    assert old.choose("express").start() == requests.express_scan(0)
    assert old.choose("standard").start() == requests.SCAN


def test_the_typical_mode_of_old_firmware_is_standard() -> None:
    assert modes.legacy_modes(SampleRate(476e-6, 238e-6), 12.0).choose().response_type == ResponseType.STANDARD


@pytest.mark.parametrize(
    ("number", "name", "motor"),
    [
        (0x18, "A1M8", models.Motor.DTR),
        (0x28, "A2M8", models.Motor.PWM),
        (0x2C, "A2M12", models.Motor.PWM),
        (0x31, "A3M1", models.Motor.PWM),
        (0x41, "C1M1", models.Motor.SCAN),
        (0x61, "S1M1", models.Motor.SPEED),
        (0x71, "S2M1", models.Motor.SPEED),
        (0x81, "S3M1", models.Motor.SPEED),
        (0xF3, "RPLIDAR 0xF3", models.Motor.SPEED),
    ],
)
def test_models_follow_from_the_model_number(number: int, name: str, motor: models.Motor) -> None:
    model = models.model_of(number)
    assert models.name_of(number) == name
    assert model.motor is motor
    assert set(model.bauds) <= set(models.BAUDS)
    assert model.triangulates == (number >> 4 <= 3)


def test_unknown_response_types_are_rejected() -> None:
    with pytest.raises(DriverError, match="type 0x99"):
        decoding.decoder_for(0x99, 1e-4, 115200, False)
    with pytest.raises(DriverError, match="type 0x99"):
        decoding.descriptor_of(0x99)
