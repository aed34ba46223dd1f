"""Protocols of the wheel bases: known bytes, round trips between host and device, damaged streams."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from drivers.bases import (
    ArduinoBridge,
    ArduinoBridgeDevice,
    Create2,
    Create2Device,
    DifferentialDrive,
    Kobuki,
    KobukiDevice,
    Odometer,
    Poll,
    Request,
    Reset,
    Stream,
    Velocity,
    WheelBase,
    WheelDevice,
    WheelLine,
    WheelLineDevice,
    WheelReading,
)
from drivers.bases.create2 import WHEELS

DRIVE = DifferentialDrive(left=1e-4, right=1.1e-4, track=0.3, bits=32, top_speed=0.8)

HOSTS: dict[str, Callable[[], WheelBase]] = {
    "create2": Create2,
    "kobuki": Kobuki,
    "arduino_bridge": lambda: ArduinoBridge(DRIVE),
    "wheel_line": lambda: WheelLine(DRIVE),
}
DEVICES: dict[str, Callable[[], WheelDevice]] = {
    "create2": Create2Device,
    "kobuki": KobukiDevice,
    "arduino_bridge": lambda: ArduinoBridgeDevice(DRIVE),
    "wheel_line": WheelLineDevice,
}
BASES = sorted(HOSTS)


def readings(name: str, count: int = 40) -> list[WheelReading]:
    """Return readings whose bytes include all that may be mistaken for the beginning of a frame."""
    bits = 16 if name in ("create2", "kobuki") else 32
    start = 0x1306 if name == "create2" else 0xAA55
    result = []
    for i in range(count):
        left, right = start + 43 * i, (1 << (bits - 1)) - 20 + 3 * i
        if bits == 16:
            left, right = left % 65536, right % 65536
        else:
            right = (right + (1 << 31)) % (1 << 32) - (1 << 31)
        time = {"create2": i, "kobuki": (65000 + 20 * i) % 65536, "wheel_line": (2**32 - 99 + 20000 * i) % 2**32}
        heading = math.radians((i - 20) * 7.25)
        result.append(
            WheelReading(
                left,
                right,
                time.get(name),
                heading if name in ("kobuki", "wheel_line") else None,
                (100 + i) / 10 if name == "kobuki" else None,
            )
        )
    return result


def chunks(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    return [data[a:b] for a, b in pairwise(edges)]


# Known bytes


def test_create2_encodes_and_decodes_known_bytes() -> None:
    assert Create2().start().endswith(bytes.fromhex("94 02 2B 2C"))
    frame = bytes.fromhex("13 06 2B 01 00 2C FF F8 98")
    assert Create2().feed(frame) == [WheelReading(256, 65528, 0)]
    assert Create2Device().encode(WheelReading(256, -8)) == frame
    assert Create2().drive(Velocity(0.2, 0.0)) == bytes.fromhex("91 00 C8 00 C8")
    assert Create2().drive(Velocity(-0.1, 1.2)) == bytes.fromhex("91 00 29 FF 0F")


def test_create2_accepts_either_checksum_and_expects_it_from_then_on() -> None:
    other = [bytes([*body, -sum(body[1:]) % 256]) for body in ([19, 6, 43, 1, i, 44, 2, 7] for i in range(8))]
    usual = [Create2Device().encode(WheelReading(i, i)) for i in range(8)]
    base = Create2()
    assert len(base.feed(other[0])) == 1
    assert base.feed(usual[0] + usual[1] + other[1]) == [WheelReading(257, 519, 3)]
    assert base.counters.bad == 2
    assert len(base.feed(b"".join(usual))) == 6  # the third in a row is accepted
    assert not base.feed(other[0])


def test_create2_estimates_lost_frames_from_the_skipped_bytes() -> None:
    device, base = Create2Device(), Create2()
    stream = [device.encode(reading) for reading in readings("create2", 10)]
    damaged = (
        b"".join(stream[:3]) + stream[3][:-1] + stream[4] + b"?" + stream[5] + b"".join(stream[6:8])[2:] + stream[8]
    )
    times = [reading.time for reading in base.feed(damaged)]
    assert times == [0, 1, 2, 4, 5, 7, 8]
    assert base.counters.lost == 2


def test_kobuki_encodes_and_decodes_known_bytes() -> None:
    frame = bytes.fromhex("AA 55 11 01 0F E8 03 00 00 00 34 12 F0 FF 00 00 00 00 A4 00 79")
    assert Kobuki().feed(frame) == [WheelReading(4660, 65520, 1000, None, 16.4)]
    assert KobukiDevice().encode(WheelReading(4660, -16, 1000, None, 16.4)) == frame
    assert Kobuki().drive(Velocity(0.1, 0.0)) == bytes.fromhex("AA 55 06 01 04 64 00 00 00 67")


def test_kobuki_heading_is_that_of_the_gyro() -> None:
    part = bytes.fromhex("04 07 28 23 9C FF 00 00 00")  # 90 degrees, -1 degree per second
    core = bytes.fromhex("01 0F E8 03 00 00 00 34 12 F0 FF 00 00 00 00 A4 00")
    body = bytes([len(core + part)]) + core + part
    checksum = 0
    for byte in body:
        checksum ^= byte
    (reading,) = Kobuki().feed(b"\xaa\x55" + body + bytes([checksum]))
    assert reading.heading == pytest.approx(math.pi / 2)


def test_kobuki_packets_without_the_core_part_contain_no_reading() -> None:
    base = Kobuki()
    body = bytes([6, 0x0A, 4, 1, 2, 3, 4])
    checksum = 0
    for byte in body:
        checksum ^= byte
    assert base.feed(b"\xaa\x55" + body + bytes([checksum])) == []
    assert base.counters.bad == base.counters.skipped == 0


def test_arduino_bridge_encodes_and_decodes_known_bytes() -> None:
    base = ArduinoBridge(DRIVE)
    assert base.poll() == b"e\r"
    assert base.feed(b"1024 -998\r\n") == [WheelReading(1024, -998)]
    assert base.feed(b"") == []
    assert base.feed(b"OK\r\n57600\r\n") == []
    assert base.counters.bad == 0
    for line in (
        b"1024\r\n",
        b"Invalid Command\r\n",
        b"\r\n",
        b"1 2 3\r\n",
        b"4294967295 0\r\n",
        b"1 2\n",
        b"1  2\r\n",
    ):
        before = base.counters.bad
        assert base.feed(line) == []
        assert base.counters.bad == before + 1, line
    assert ArduinoBridgeDevice(DRIVE).encode(WheelReading(1024, -998)) == b"1024 -998\r\n"


def test_arduino_bridge_drives_in_counts_per_control_period() -> None:
    assert ArduinoBridge(DRIVE).drive(Velocity(0.33, 0.0)) == b"m 110 100\r"


def test_wheel_line_encodes_and_decodes_known_bytes() -> None:
    line = b"O,1,20000,10,-5*55\n"
    assert WheelLine(DRIVE).feed(line) == [WheelReading(10, -5, 20000)]
    assert WheelLine(DRIVE).drive(Velocity(0.25, -0.5)) == b"V,250,-500*79\n"
    turned = WheelLine(DRIVE).feed(b"O,65535,4294967295,-2147483648,2147483647,-90000*68\n")
    assert turned == [WheelReading(-(1 << 31), (1 << 31) - 1, (1 << 32) - 1, -math.pi / 2)]


@pytest.mark.parametrize(
    "text", [b"O,65536,0,0,0", b"O,0,4294967296,0,0", b"O,0,0,2147483648,0", b"O,0,0,0", b"V,1,2", b""]
)
def test_wheel_line_rejects_invalid_readings_with_correct_checksums(text: bytes) -> None:
    checksum = 0
    for byte in text:
        checksum ^= byte
    base = WheelLine(DRIVE)
    assert base.feed(b"%b*%02X\n" % (text, checksum)) == []
    assert base.counters.bad == 1


def test_wheel_line_counts_lost_lines_and_restarts() -> None:
    device, base = WheelLineDevice(), WheelLine(DRIVE)
    lines = [device.encode(reading) for reading in readings("wheel_line", 10)]
    base.feed(b"".join(lines[:4] + lines[7:]))
    assert base.counters.lost == 3
    base.feed(lines[0])
    assert base.counters.restarts == 1


# All bases


@pytest.mark.parametrize("name", BASES)
def test_the_host_decodes_the_readings_of_the_device(name: str) -> None:
    device, base = DEVICES[name](), HOSTS[name]()
    sent = readings(name)
    got = base.feed(b"".join(device.encode(reading) for reading in sent))
    assert len(got) == len(sent) == base.counters.good
    for one, other in zip(got, sent, strict=True):
        assert replace(one, heading=None) == replace(other, heading=None)
        assert (one.heading is None) == (other.heading is None)
        assert one.heading is None or other.heading is None or abs(one.heading - other.heading) < 1e-4
    assert base.counters.bad == base.counters.skipped == base.counters.lost == 0


@pytest.mark.parametrize("name", BASES)
@settings(max_examples=60, deadline=None)
@given(speed=st.floats(-2.0, 2.0), turn_rate=st.floats(-10.0, 10.0))
@example(speed=0.007, turn_rate=5.0)  # an arc of 1.4 mm
@example(speed=-0.007, turn_rate=5.0)
def test_the_device_decodes_the_commands_of_the_host(name: str, speed: float, turn_rate: float) -> None:
    device, base = DEVICES[name](), HOSTS[name]()
    device.feed(base.start())
    (got,) = device.feed(base.enable_driving() + base.drive(Velocity(speed, turn_rate)))
    assert isinstance(got, Velocity)
    left, right = base.wheels.wheel_speeds(speed, turn_rate)
    half = got.turn_rate * base.wheels.track / 2
    assert max(abs(got.speed - half), abs(got.speed + half)) <= base.wheels.top_speed + 0.004
    # Speeds are sent in mm/s and mrad/s, in counts per control period (3.3 mm/s), or as radii in mm, of which 1 means
    # turning on the spot.
    turns = (right - left) / base.wheels.track
    assert got.speed == pytest.approx((left + right) / 2, abs=0.004 + 0.001 * abs(turns))
    assert got.turn_rate == pytest.approx(turns, abs=0.03 + 0.005 * abs(turns))


@pytest.mark.parametrize("name", BASES)
def test_reading_a_base_sends_no_velocity(name: str) -> None:
    device, base = DEVICES[name](), HOSTS[name]()
    requests = device.feed(base.start() + base.poll() + base.start() + base.end())
    assert not any(isinstance(request, Velocity) for request in requests)


def test_create2_device_drives_in_safe_mode_only_and_stops_on_leaving_it() -> None:
    device, base = Create2Device(), Create2()
    drive, stopped = base.drive(Velocity(0.1, 0.0)), Velocity(0.0, 0.0)
    assert device.feed(base.enable_driving() + drive) == []
    assert device.feed(base.start() + drive) == [Stream(True)]
    assert device.feed(base.enable_driving() + drive) == [Velocity(0.1, 0.0)]
    assert device.feed(base.start() + drive) == [stopped, Stream(True)]
    assert device.feed(base.enable_driving() + base.end()) == [Stream(False), stopped, Stream(False)]
    assert device.feed(drive) == []


def test_arduino_bridge_device_decodes_requests() -> None:
    requests: list[Request] = ArduinoBridgeDevice(DRIVE).feed(b"\re\rr\rhello\r")
    assert requests == [Poll(), Reset()]


@pytest.mark.parametrize("name", BASES)
@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_readings_do_not_depend_on_the_chunks(name: str, data: st.DataObject) -> None:
    device = DEVICES[name]()
    stream = bytearray(b"".join(device.encode(reading) for reading in readings(name, 12)))
    for place in data.draw(st.lists(st.integers(0, len(stream) - 1), max_size=4)):
        stream[place : place + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    whole, cut = HOSTS[name](), HOSTS[name]()
    cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=30))
    got = [reading for chunk in chunks(bytes(stream), cuts) for reading in cut.feed(chunk)]
    assert got == whole.feed(bytes(stream))
    assert cut.counters == whole.counters


HOSTILE = st.lists(
    st.one_of(
        st.binary(max_size=40),
        st.sampled_from(
            [b"\x13\x06\x2b", b"\xaa\x55", b"\xaa\x55\xff", b"O,1,2,3,4*", b"V,", b"\r", b"\n", b"e\r", b"9" * 99]
        ),
        st.sampled_from([b"\x94", b"\x94\xff", b"\x91", b"\x80\x83", b"m 1 2\r", b"\x00" * 300]),
    ),
    max_size=30,
)


@pytest.mark.parametrize("name", BASES)
@given(noise=HOSTILE)
@settings(max_examples=80, deadline=None)
def test_parsers_resynchronise_after_arbitrary_bytes(name: str, noise: list[bytes]) -> None:
    base, device = HOSTS[name](), DEVICES[name]()
    for chunk in noise:
        base.feed(chunk)
        device.feed(chunk)
    total = sum(map(len, noise))
    assert base.counters.skipped <= total
    assert base.counters.good <= total / 5
    # after any bytes, readings are decoded again once the unfinished frame has ended
    found = base.feed(b"".join(DEVICES[name]().encode(reading) for reading in readings(name, 40)))
    assert [r.left for r in found][-5:] == [r.left for r in readings(name, 40)][-5:]


@pytest.mark.parametrize("name", BASES)
def test_memory_of_the_parsers_is_bounded(name: str) -> None:
    parsers: list[WheelBase | WheelDevice] = [HOSTS[name](), DEVICES[name]()]
    random = np.random.default_rng(1)
    for parser in parsers:
        for filling in (b"\xaa" * 5000, b"\x13\x06" * 2500, b"1" * 5000, b"\x94" * 5000, random.bytes(20000)):
            parser.feed(filling)
            holder = parser
            for attribute in ("_frames", "_lines"):
                holder = getattr(holder, attribute, holder)
            assert len(holder._buffer) < 300  # type: ignore[union-attr]


def damaged(stream: bytes, place: int) -> list[tuple[str, bytes]]:
    """Return (kind, stream) with one byte dropped, inserted or flipped at a place: all flips, several insertions."""
    before, here, after = stream[:place], stream[place], stream[place + 1 :]
    flipped = [("flip", before + bytes([here ^ (1 << bit)]) + after) for bit in range(8)]
    inserted = [
        ("insert", before + bytes([byte, here]) + after) for byte in (0, 0x13, 0x2C, 0x55, 0xAA, 48 + place % 10)
    ]
    return [("drop", before + after), *flipped, *inserted]


@pytest.mark.parametrize("name", ["create2", "kobuki", "wheel_line"])
def test_a_damaged_byte_loses_at_most_two_readings_and_rarely_changes_one(name: str) -> None:
    sent = readings(name, 16)
    device = DEVICES[name]()
    frames = [device.encode(reading) for reading in sent]
    stream, rest = b"".join(frames[:8]), b"".join(frames[8:])  # a false frame consumes a part of the rest
    expected = {(reading.left, reading.right) for reading in sent}
    wrong = {"drop": 0, "insert": 0, "flip": 0}
    tried = 0
    for place in range(len(stream)):
        for kind, bytes_ in damaged(stream, place):
            got = HOSTS[name]().feed(bytes_ + rest)
            wrong[kind] += not {(reading.left, reading.right) for reading in got} <= expected
            assert len(got) >= len(sent) - 2, (place, kind)
            tried += 1
    assert wrong["flip"] == 0
    # a sum or an exclusive or does not detect a lost byte if the next frame's first byte replaces it
    assert sum(wrong.values()) <= (0 if name == "wheel_line" else 0.003 * tried)


def test_commands_beyond_the_top_speed_keep_their_arc() -> None:
    left, right = WHEELS.wheel_speeds(2.0, 1.0)
    assert right == WHEELS.top_speed
    assert (right + left) / (right - left) * WHEELS.track / 2 == pytest.approx(2.0)


def noisy(stream: bytes, share: float, random: np.random.Generator) -> bytes:
    """Return the stream with a share of its bytes dropped, followed by a random byte, or flipped in one bit."""
    out = bytearray()
    for byte, fault, value in zip(
        stream, random.random(len(stream)), random.integers(256, size=len(stream)), strict=True
    ):
        if fault >= share:
            out.append(byte)
        elif fault >= 2 * share / 3:
            out.append(byte ^ (1 << (int(value) % 8)))
        elif fault >= share / 3:
            out += bytes([byte, int(value)])
    return bytes(out)


@pytest.mark.parametrize("name", BASES)
def test_odometry_over_a_noisy_line_ends_at_the_same_pose(name: str) -> None:
    random = np.random.default_rng(11)
    base, device = HOSTS[name](), DEVICES[name]()
    count, period = 2000, 0.02
    t = np.arange(count) * period
    speed, turn_rate = 0.3 + 0.1 * np.sin(t / 5), 0.6 * np.sin(t / 3)
    left, right = (
        np.round(np.cumsum(speed + side * turn_rate * base.wheels.track / 2) * period / metres).astype(int).tolist()
        for side, metres in ((-1, base.wheels.left), (1, base.wheels.right))
    )
    noisy_odometer, clean = Odometer(base.wheels), Odometer(base.wheels)
    max_error = 0.0
    for i in range(count):
        reading = WheelReading(left[i], right[i], 20 * i)
        expected = clean.add(reading, t[i])
        assert expected is not None
        for got in base.feed(noisy(device.encode(reading), 1e-3, random)):
            message = noisy_odometer.add(got, t[i])
            if message is not None:
                max_error = max(max_error, float(np.hypot(*(message.pose - expected.pose)[:2])))
    # readings that are delayed by a false frame are a few periods old
    assert max_error < 0.06
    assert_allclose(noisy_odometer.pose, clean.pose, atol=0.01)
    assert noisy_odometer.counters.resets == 0
    assert base.counters.bad > 0
    assert base.counters.good > 0.95 * count
