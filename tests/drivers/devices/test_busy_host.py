"""Two devices read by a host that puts its programs aside at any moment, in simulated time: no message is lost, their
order holds, and their stamps are right again as soon as the host comes to itself.
"""

from __future__ import annotations

import heapq
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers import Message, Odometry, Scan
from drivers.bases import Create2Device, KobukiDevice, WheelReading, create2, kobuki
from drivers.devices.device import READ_PAUSE
from drivers.devices.lidar import LidarDevice, LidarStream
from drivers.devices.reorder_buffer import MAX_HOLD, ReorderBuffer
from drivers.devices.wheel_base import WheelBaseDevice
from drivers.lidars import ld06
from drivers.lidars.rplidar import dense
from drivers.lidars.rplidar.decoding import decoder_for
from drivers.transport import Received, transport
from drivers.transport.transport import read_promptly

SECONDS, START = 5.0, 1000.0
TURNS = 10.0
"""Revolutions a second."""
COUNTED = 10_000
"""Samples after which the ranges, which count them in millimetres, begin again."""
CALL = 2e-5
"""Seconds that the host takes for a call of the system."""


class Sent(NamedTuple):
    """What a device sends: packets of one size, and when each is through the line (n,), seconds."""

    data: bytes
    size: int
    times: np.ndarray


def dense_lidar() -> tuple[LidarStream, float, Sent]:
    """One that tells no time; how it is understood, its samples a second, and what it sends."""
    rate, baud, size = 9200.0, 256000.0, 84
    samples = np.arange(int(SECONDS * rate)).reshape(-1, 40)
    heads = 2 * np.pi * TURNS / rate * samples[:, 0]
    data = dense.encode(heads, 1.0 + samples % COUNTED / 1e3, reset=True)
    stream = LidarStream(decoder_for(0x85, 1 / rate, baud, False), 40 / rate, size, (0.1, 40.0))
    return stream, rate, Sent(data, size, START + (samples[:, -1] + 1.5) / rate + size * 10 / baud)


def telling_lidar() -> tuple[LidarStream, float, Sent]:
    """One that tells its own time, on a clock that runs slow."""
    rate, size = ld06.SAMPLE_RATE, ld06.LAYOUT.itemsize
    data, samples = b"", np.arange(int(SECONDS * rate)).reshape(-1, ld06.POINTS)
    for row in samples:
        bearings = 2 * np.pi * TURNS / rate * row[None, [0, -1]]
        ranges, bright = 1.0 + row[None] % COUNTED / 1e3, np.full((1, ld06.POINTS), 200)
        data += ld06.encode(bearings, ranges, bright, 2 * np.pi * TURNS, row[-1] / rate / 1.0001)
    stream = LidarStream(ld06.Ld06Decoder(), ld06.POINTS / rate, size, (0.1, 40.0))
    return stream, rate, Sent(data, size, START + samples[:, -1] / rate + size * 10 / ld06.BAUD)


def counting_base() -> tuple[WheelBaseDevice, float, Sent]:
    """One that tells no time; its seconds between readings, and what it sends."""
    frames = [Create2Device().encode(WheelReading(i, i)) for i in range(int(SECONDS / 0.015))]
    return WheelBaseDevice("create2", {}), 0.015, sent(frames, 0.015, create2.Create2.baud)


def telling_base() -> tuple[WheelBaseDevice, float, Sent]:
    """One that tells milliseconds, on a clock that wraps meanwhile and runs slow."""
    first = kobuki.Kobuki.wraps_at - 2000
    times = [first + int(20 * i / 1.0001) for i in range(int(SECONDS / 0.02))]
    frames = [KobukiDevice().encode(WheelReading(i, i, time)) for i, time in enumerate(times)]
    return WheelBaseDevice("kobuki", {}), 0.02, sent(frames, 0.02, kobuki.Kobuki.baud)


def sent(frames: list[bytes], period: float, baud: float) -> Sent:
    size = len(frames[0])
    return Sent(b"".join(frames), size, START + period * np.arange(len(frames)) + size * 10 / baud)


class PluggedLidar(LidarDevice):
    """Found already."""

    def __init__(self, stream: LidarStream) -> None:
        super().__init__({})
        self._plugged = stream
        nobody: Any = None
        self.start(nobody, 0)

    def identify(self, transport: Any, baud: int) -> None:
        pass

    def halt(self, transport: Any) -> None:
        pass

    def _start_stream(self, transport: Any, baud: int) -> LidarStream:
        return self._plugged


@dataclass
class Host:
    """What a thread has of the processor.

    chance, longest  that it is put aside before the end of a call, and for how many seconds at most
    frozen           when nothing runs on the whole computer, (n, 2) seconds
    """

    random: np.random.Generator
    chance: float
    longest: float
    frozen: np.ndarray
    now: float = START

    def monotonic(self) -> float:
        """The time, in place of the module's `time`."""
        aside = self.random.uniform(0.0, self.longest) if self.random.random() < self.chance else 0.0
        self.sleep(CALL + aside)
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds
        for begin, end in self.frozen:
            if begin <= self.now < end:
                self.now = end + self.random.uniform(0.0, 2e-3)


def reads(number: int, device: Sent, host: Host, patch: pytest.MonkeyPatch) -> Iterator[tuple[float, int, Received]]:
    """What a thread reads of a device of some number: when it can work on it (seconds), the number, and that."""
    byte_times = np.repeat(device.times, device.size).tolist()
    at = 0

    def take() -> bytes:
        nonlocal at
        before, at = at, bisect_right(byte_times, host.now)
        return device.data[before:at]

    while at < len(device.data):
        host.sleep(max(0.0, byte_times[at] - host.now))
        patch.setattr(transport, "time", host)
        received = read_promptly(take)
        yield host.monotonic(), number, received
        host.sleep(READ_PAUSE)


@dataclass
class Drive:
    """What came of it: the messages given out, their errors (seconds), and how many there should be."""

    lidar: PluggedLidar
    base: WheelBaseDevice
    buffer: ReorderBuffer
    messages: list[Message] = field(default_factory=list)
    errors: np.ndarray = field(default_factory=lambda: np.empty(0))
    scans: int = 0
    readings: int = 0


def drive(robot: str, seed: int, chance: float, longest: float, freezes: int, patch: pytest.MonkeyPatch) -> Drive:
    stream, rate, scanned = dense_lidar() if robot == "counting" else telling_lidar()
    base, period, rolled = counting_base() if robot == "counting" else telling_base()
    random = np.random.default_rng(seed)
    begins = random.uniform(START + 1.0, START + SECONDS, freezes)
    frozen = np.stack([begins, begins + random.uniform(0.2, MAX_HOLD - 0.2, freezes)], axis=1)
    result = Drive(PluggedLidar(stream), base, ReorderBuffer(2, 0.0))
    hosts = [Host(child, chance, longest, frozen) for child in random.spawn(2)]
    threads = [reads(number, device, hosts[number], patch) for number, device in enumerate((scanned, rolled))]
    read = [START, START]
    for _, number, received in heapq.merge(*threads, key=lambda event: event[0]):
        result.messages += result.buffer.pop(min(read), 0.0)
        result.buffer.put(number, (result.lidar, base)[number].feed(received))
        read[number] = received.time
        result.messages += result.buffer.pop(min(read), 0.0)
    result.messages += result.buffer.flush()
    result.errors = np.array([error_of(message, rate, period, base) for message in result.messages])
    result.scans, result.readings = int(SECONDS * TURNS) - 1, len(rolled.times)
    return result


def error_of(message: Message, rate: float, period: float, base: WheelBaseDevice) -> float:
    """Seconds by which a stamp is later than the truth, which the devices tell in what they measure."""
    if isinstance(message, Scan):
        sample = round(1e3 * float(message.ranges[np.argmin(message.time_offsets)])) - 1000
        again = COUNTED / rate
        return float((message.stamp - START - sample / rate + again / 2) % again - again / 2)
    assert isinstance(message, Odometry)
    reading = round(float(message.pose[0]) / base._wheels.left)
    return message.stamp - START - reading * period


def assert_in_order(driven: Drive) -> None:
    stamps = np.array([message.stamp for message in driven.messages])
    assert np.all(np.diff(stamps) >= 0.0)
    assert (driven.buffer.late, driven.buffer.dropped) == (0, 0)


def assert_complete(driven: Drive) -> None:
    scans = [message for message in driven.messages if isinstance(message, Scan)]
    assert driven.scans - 1 <= len(scans) <= driven.scans  # the last one may not be whole
    assert len(driven.messages) - len(scans) == driven.readings
    for before, after in pairwise(scans):
        assert before.stamp + before.duration <= after.stamp
    lidar, base = driven.lidar.counters(), driven.base.counters()
    assert lidar["incomplete_revolutions"] == lidar["packets_lost"] == base["lost"] == base["disordered"] == 0


@pytest.mark.parametrize("robot", ["counting", "telling"])
@pytest.mark.parametrize(
    ("chance", "longest", "freezes"),
    [(0.0, 0.0, 0), (0.02, 0.04, 0), (0.1, 0.09, 0), (0.02, 0.2, 0), (0.01, 0.03, 2)],
    ids=["idle", "busy", "crowded", "stumbling", "freezing"],
)
def test_a_busy_host_loses_nothing_and_stamps_rightly(
    robot: str, chance: float, longest: float, freezes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for seed in range(3):
        driven = drive(robot, seed, chance, longest, freezes, monkeypatch)
        assert_in_order(driven)
        assert_complete(driven)
        settled = np.array([message.stamp for message in driven.messages]) > START + 1.0
        assert np.quantile(np.abs(driven.errors[settled]), 0.99) < 0.002
        assert driven.errors.min() > -0.002
        assert driven.errors.max() < (0.02 if longest else 0.002)  # before the first prompt read nobody can know better


@pytest.mark.parametrize("robot", ["counting", "telling"])
@pytest.mark.parametrize(("chance", "longest"), [(0.6, 0.1), (0.3, 1.0)])
def test_the_order_holds_on_a_host_that_is_hardly_ever_prompt(
    robot: str, chance: float, longest: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There packets seem to be lost and clocks to jump, but no message comes late."""
    for seed in range(6):
        driven = drive(robot, seed, chance, longest, 1, monkeypatch)
        assert_in_order(driven)
        assert len(driven.messages) > 0.8 * (driven.scans + driven.readings)
