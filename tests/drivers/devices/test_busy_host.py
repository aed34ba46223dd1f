"""Two devices read by a host that suspends its programs at random, in simulated time: no message is lost, their order
is kept, and their stamps are right as soon as the host reads promptly again.
"""

from __future__ import annotations

import heapq
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers import Message, Odometry, Scan
from drivers.bases import Create2Device, KobukiDevice, WheelReading, create2, kobuki
from drivers.devices.device import READ_PAUSE
from drivers.devices.lidar import LidarDevice, LidarStream
from drivers.devices.packet_stamper import SETTLING_SECONDS
from drivers.devices.reorder_buffer import MAX_HOLD, ReorderBuffer
from drivers.devices.wheel_base import WheelBaseDevice
from drivers.lidars import ld06
from drivers.lidars.rplidar import dense
from drivers.lidars.rplidar.decoding import decoder_for
from drivers.transport import Received, transport
from drivers.transport.transport import LINE_BUFFER, read_promptly

SECONDS, START = 5.0, 1000.0
TURNS = 10.0
"""Revolutions per second."""
RANGE_PERIOD = 10_000
"""Samples after which the ranges, which count the samples in millimetres, repeat."""
SYSTEM_CALL_DURATION = 2e-5
"""Seconds of a system call."""


class Sent(NamedTuple):
    """Bytes of a device: packets of one size, and the times (n,) at which each is transmitted, seconds."""

    data: bytes
    size: int
    times: np.ndarray


def clockless_lidar() -> tuple[LidarStream, float, Sent]:
    """Return a lidar stream without device time, its samples per second, and its bytes."""
    rate, baud, size = 9200.0, 256000.0, 84
    samples = np.arange(int(SECONDS * rate)).reshape(-1, 40)
    heads = 2 * np.pi * TURNS / rate * samples[:, 0]
    data = dense.encode(heads, 1.0 + samples % RANGE_PERIOD / 1e3, reset=True)
    stream = LidarStream(decoder_for(0x85, 1 / rate, baud, False), 40 / rate, size, (0.1, 40.0))
    return stream, rate, Sent(data, size, START + (samples[:, -1] + 1.5) / rate + size * 10 / baud)


def clocked_lidar() -> tuple[LidarStream, float, Sent]:
    """Return a lidar stream with device time, on a clock that runs slow, its samples per second, and its bytes."""
    scans = sent_by_clocked_lidar()
    rate = ld06.LD06.sample_rate
    return LidarStream(ld06.Ld06Decoder(), ld06.POINTS / rate, scans.size, (0.1, 40.0)), rate, scans


@cache
def sent_by_clocked_lidar() -> Sent:
    rate, size = ld06.LD06.sample_rate, ld06.LAYOUT.itemsize
    data, samples = b"", np.arange(int(SECONDS * rate)).reshape(-1, ld06.POINTS)
    for row in samples:
        bearings = 2 * np.pi * TURNS / rate * row[None, [0, -1]]
        ranges, bright = 1.0 + row[None] % RANGE_PERIOD / 1e3, np.full((1, ld06.POINTS), 200)
        data += ld06.encode(bearings, ranges, bright, 2 * np.pi * TURNS, row[-1] / rate / 1.0001)
    return Sent(data, size, START + samples[:, -1] / rate + size * 10 / ld06.LD06.baud)


def clockless_base() -> tuple[WheelBaseDevice, float, Sent]:
    """Return a wheel base without device time, its seconds between readings, and its bytes."""
    frames = [Create2Device().encode(WheelReading(i, i)) for i in range(int(SECONDS / 0.015))]
    return WheelBaseDevice("create2", {}), 0.015, sent(frames, 0.015, create2.Create2.baud)


def clocked_base() -> tuple[WheelBaseDevice, float, Sent]:
    """Return a wheel base that sends milliseconds, on a clock that wraps and runs slow, its seconds between readings,
    and its bytes.
    """
    first = kobuki.Kobuki.wraps_at - 2000
    times = [first + int(20 * i / 1.0001) for i in range(int(SECONDS / 0.02))]
    frames = [KobukiDevice().encode(WheelReading(i, i, time)) for i, time in enumerate(times)]
    return WheelBaseDevice("kobuki", {}), 0.02, sent(frames, 0.02, kobuki.Kobuki.baud)


def sent(frames: list[bytes], period: float, baud: float) -> Sent:
    size = len(frames[0])
    return Sent(b"".join(frames), size, START + period * np.arange(len(frames)) + size * 10 / baud)


class PluggedLidar(LidarDevice):
    """A lidar that is already connected."""

    def __init__(self, stream: LidarStream) -> None:
        super().__init__({})
        self._plugged = stream
        nobody: Any = None
        self.start(nobody, 0)

    def identify(self, transport: Any, baud: int) -> None:
        pass

    def halt(self, transport: Any) -> None:
        pass

    def start_stream(self, transport: Any, baud: int) -> LidarStream:
        return self._plugged


@dataclass
class Host:
    """Scheduling of a thread, and its serial port, of which the system makes LINE_BUFFER bytes available at a time.

    chance, longest  probability of being suspended before the end of a call, and maximum duration in seconds
    frozen           (n, 2) intervals in seconds in which nothing runs on the whole computer
    """

    random: np.random.Generator
    chance: float
    longest: float
    frozen: np.ndarray
    now: float = START

    def monotonic(self) -> float:
        """Return the simulated time, in place of the module's `time`."""
        aside = self.random.uniform(0.0, self.longest) if self.random.random() < self.chance else 0.0
        self.sleep(SYSTEM_CALL_DURATION + aside)
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds
        for begin, end in self.frozen:
            if begin <= self.now < end:
                self.now = end + self.random.uniform(0.0, 2e-3)


def reads(number: int, device: Sent, host: Host, patch: pytest.MonkeyPatch) -> Iterator[tuple[float, int, Received]]:
    """Yield the reads of a thread: time of processing (seconds), number of the device, and received bytes."""
    byte_times = np.repeat(device.times, device.size).tolist()
    at = 0

    def take() -> bytes:
        nonlocal at
        before, at = at, min(bisect_right(byte_times, host.now), at + LINE_BUFFER)
        return device.data[before:at]

    while at < len(device.data):
        host.sleep(max(0.0, byte_times[at] - host.now))
        patch.setattr(transport, "time", host)
        received = read_promptly(take, LINE_BUFFER)
        yield host.monotonic(), number, received
        host.sleep(READ_PAUSE)


@dataclass
class Run:
    """Result of a simulated run: the messages, their stamp errors (seconds), and the expected counts."""

    lidar: PluggedLidar
    base: WheelBaseDevice
    buffer: ReorderBuffer
    messages: list[Message] = field(default_factory=list)
    errors: np.ndarray = field(default_factory=lambda: np.empty(0))
    scans: int = 0
    readings: int = 0


def simulate_run(robot: str, seed: int, chance: float, longest: float, freezes: int, patch: pytest.MonkeyPatch) -> Run:
    stream, rate, scanned = clockless_lidar() if robot == "clockless" else clocked_lidar()
    base, period, rolled = clockless_base() if robot == "clockless" else clocked_base()
    metres_per_count = (create2 if robot == "clockless" else kobuki).WHEELS.left
    random = np.random.default_rng(seed)
    begins = random.uniform(START + 1.0, START + SECONDS, freezes)
    frozen = np.stack([begins, begins + random.uniform(0.2, MAX_HOLD - SETTLING_SECONDS - 0.2, freezes)], axis=1)
    result = Run(PluggedLidar(stream), base, ReorderBuffer(2, 0.0))
    hosts = [Host(child, chance, longest, frozen) for child in random.spawn(2)]
    threads = [reads(number, device, hosts[number], patch) for number, device in enumerate((scanned, rolled))]
    read = [START, START]
    for _, number, received in heapq.merge(*threads, key=lambda event: event[0]):
        result.messages += result.buffer.pop(min(read), 0.0)
        result.buffer.put(number, (result.lidar, base)[number].feed(received))
        read[number] = received.time
        result.messages += result.buffer.pop(min(read), 0.0)
    result.messages += result.buffer.flush()
    result.errors = np.array([error_of(message, rate, period, metres_per_count) for message in result.messages])
    result.scans, result.readings = int(SECONDS * TURNS) - 1, len(rolled.times)
    return result


def error_of(message: Message, rate: float, period: float, metres_per_count: float) -> float:
    """Return the seconds by which a stamp is later than the truth, which the devices encode in their measurements."""
    if isinstance(message, Scan):
        sample = round(1e3 * float(message.ranges[np.argmin(message.time_offsets)])) - 1000
        again = RANGE_PERIOD / rate
        return float((message.stamp - START - sample / rate + again / 2) % again - again / 2)
    assert isinstance(message, Odometry)
    reading = round(float(message.pose[0]) / metres_per_count)
    return message.stamp - START - reading * period


def assert_in_order(run: Run) -> None:
    stamps = np.array([message.stamp for message in run.messages])
    assert np.all(np.diff(stamps) >= 0.0)
    assert (run.buffer.late, run.buffer.dropped) == (0, 0)


def assert_complete(run: Run) -> None:
    scans = [message for message in run.messages if isinstance(message, Scan)]
    assert run.scans - 1 <= len(scans) <= run.scans  # the last one may be incomplete
    assert len(run.messages) - len(scans) == run.readings
    for before, after in pairwise(scans):
        assert before.stamp + before.duration <= after.stamp
    lidar, base = run.lidar.counters(), run.base.counters()
    assert lidar["incomplete_revolutions"] == lidar["packets_lost"] == base["lost"] == base["disordered"] == 0


@pytest.mark.parametrize("robot", ["clockless", "clocked"])
@pytest.mark.parametrize(
    ("chance", "longest", "freezes"),
    [
        pytest.param(0.0, 0.0, 0, id="idle", marks=pytest.mark.slow),
        pytest.param(0.02, 0.04, 0, id="busy", marks=pytest.mark.slow),
        pytest.param(0.1, 0.09, 0, id="crowded"),
        pytest.param(0.02, 0.2, 0, id="stumbling", marks=pytest.mark.slow),
        pytest.param(0.01, 0.03, 2, id="freezing", marks=pytest.mark.slow),
    ],
)
def test_stamps_and_messages_of_a_busy_host_are_right(
    robot: str, chance: float, longest: float, freezes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for seed in range(3 if chance else 1):  # nothing is random if the host is never suspended
        run = simulate_run(robot, seed, chance, longest, freezes, monkeypatch)
        assert_in_order(run)
        assert_complete(run)
        settled = np.array([message.stamp for message in run.messages]) > START + 1.0
        assert np.quantile(np.abs(run.errors[settled]), 0.99) < 0.002
        assert run.errors.min() > -0.002
        assert run.errors.max() < (0.02 if longest else 0.002)  # the delay is unknown before the first prompt read


@pytest.mark.parametrize(("chance", "longest"), [pytest.param(0.6, 0.05, marks=pytest.mark.slow), (0.6, 0.1)])
def test_a_heavily_loaded_host_is_not_taken_for_lost_packets(
    chance: float, longest: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half of all reads are late, often several in a row; nothing is lost, and scans stay a turn apart."""
    for seed in range(8):
        run = simulate_run("clockless", seed, chance, longest, 0, monkeypatch)
        assert_complete(run)
        assert run.lidar.counters()["clock_jumps"] == 0
        scans = [message.stamp for message in run.messages if isinstance(message, Scan)]
        assert np.diff(scans).min() > 0.9 / TURNS


@pytest.mark.slow
def test_bytes_that_wait_for_several_reads_are_not_taken_for_lost_packets(monkeypatch: pytest.MonkeyPatch) -> None:
    """In some tenths of a second more bytes arrive than one read returns, and all of these reads are late."""
    for seed in range(8):
        run = simulate_run("clockless", seed, 0.01, 0.8, 0, monkeypatch)
        assert_in_order(run)
        assert_complete(run)
        assert run.lidar.counters()["clock_jumps"] == 0


@pytest.mark.parametrize("robot", ["clockless", "clocked"])
@pytest.mark.parametrize(("chance", "longest"), [pytest.param(0.6, 0.1, marks=pytest.mark.slow), (0.3, 1.0)])
def test_messages_stay_in_order_on_a_heavily_loaded_host(
    robot: str, chance: float, longest: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Packets seem to be lost and clocks to jump there, but no message is late."""
    for seed in range(6):
        run = simulate_run(robot, seed, chance, longest, 1, monkeypatch)
        assert_in_order(run)
        assert len(run.messages) > 0.8 * (run.scans + run.readings)
