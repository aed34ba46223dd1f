"""Stamps from the arrival of chunks: right for any delay, also after lost packets."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.devices.packet_stamper import LOSS_DELAY, MIN_SPACING, MonotonicStamps, PacketCountClock, PacketStamper
from drivers.lidars.measurements import Measurements
from drivers.lidars.rplidar import dense, standard
from drivers.lidars.rplidar.decoding import decoder_for
from drivers.messages import Floats
from drivers.transport import Received

RATE, TURNS, BAUD = 9200.0, 10.0, 460800
SECONDS = 8.0
READ = 0.005
START = 1000.0


def stream(kind: str) -> tuple[bytes, int, int]:
    """Return eight seconds of a lidar whose ranges count its samples modulo 10 000 in millimetres, with the bytes and
    samples of a packet.
    """
    samples = np.arange(round(SECONDS * RATE) // 40 * 40)
    turns = samples * TURNS / RATE
    ranges = (1000 + samples % 10_000) / 1e3
    if kind == "dense":
        heads = 2 * np.pi * turns.reshape(-1, 40)[:, 0]
        return dense.encode(heads, ranges.reshape(-1, 40), reset=True), 84, 40
    starts = np.diff(np.floor(turns + 1e-9), prepend=-1.0) > 0
    return standard.encode(2 * np.pi * turns, ranges, np.full(len(samples), 20), starts), 5, 1


@pytest.mark.parametrize("kind", ["dense", "standard"])
@pytest.mark.parametrize("lost", [pytest.param(0.0, marks=pytest.mark.slow), 0.5])
def test_stamps_are_the_times_of_measurement(kind: str, lost: float) -> None:
    data, size, count = stream(kind)
    random = np.random.default_rng(3)
    answer = 0x85 if kind == "dense" else 0x81
    decoder = decoder_for(answer, 1 / RATE, BAUD, False)
    stamper = PacketStamper(count / RATE, size)
    # A packet's last byte arrives when its last sample was measured, filtered and transmitted.
    filtered = 1.5 if kind == "dense" else decoder_delay()
    packets = len(data) // size
    byte_times = START + np.repeat((np.arange(packets) * count + count - 1 + filtered) / RATE + size * 10 / BAUD, size)
    kept = np.ones(len(data), dtype=bool)
    if lost:  # a tenth of a second, and single bytes later
        kept[len(data) // 3 : len(data) // 3 + int(lost * len(data) / SECONDS)] = False
        kept[random.integers(len(data) // 2, len(data), 20)] = False
    data, byte_times = bytes(np.frombuffer(data, np.uint8)[kept]), byte_times[kept]
    now, at, errors = START, 0, []
    while at < len(data):
        now += READ + (0.03 * random.random() if random.random() < 0.3 else 0.0)
        end = int(np.searchsorted(byte_times, now, side="right"))
        received = Received(data[at:end], now)
        at = end
        if not received.data:
            continue
        stamper.add_chunk(received)
        errors += [errors_of(*stamped) for stamped in stamper.add(decoder.feed(received.data))]
    error = np.abs(np.concatenate(errors))
    assert len(error) > 0.85 * SECONDS * RATE
    assert np.quantile(error, 0.99) < 0.002
    assert np.median(error) < 0.001


def errors_of(measurements: Measurements, stamps: Floats) -> Floats:
    """Return the errors (n,) of the stamps of valid samples, seconds, up to a period of the ranges."""
    valid = ~np.isnan(measurements.samples["range"])
    told = np.round(measurements.samples["range"][valid] * 1e3) - 1000
    period = 10_000 / RATE
    return np.asarray((stamps[valid] - (START + told / RATE) + period / 2) % period - period / 2)


def test_a_host_that_is_busy_at_first_does_not_delay_stamps() -> None:
    """All bytes of the first 0.2 s arrive late by 0.2 s, the next ones by less and less."""
    data, size, count = stream("dense")
    decoder, stamper = decoder_for(0x85, 1 / RATE, BAUD, False), PacketStamper(count / RATE, size)
    stamped = []
    for packet in range(2 * round(RATE) // count):
        sent = START + (packet * count + count - 1 + 1.5) / RATE + size * 10 / BAUD
        received = Received(data[size * packet : size * (packet + 1)], max(sent, min(sent + 0.2, START + 0.4)))
        stamper.add_chunk(received)
        stamped += stamper.add(decoder.feed(received.data))
    assert sum(len(measurements) for measurements, _ in stamped) > 2 * RATE - 3 * count
    assert np.abs(np.concatenate([errors_of(*one) for one in stamped])).max() < 0.001


@pytest.mark.parametrize(
    "factor", [0.01, 0.5, *(pytest.param(factor, marks=pytest.mark.slow) for factor in (2.0, 100.0, 1e5))]
)
def test_packets_are_not_stamped_after_their_arrival_if_the_period_is_wrong(factor: float) -> None:
    data, size, count = stream("dense")
    decoder, stamper = decoder_for(0x85, 1 / RATE, BAUD, False), PacketStamper(factor * count / RATE, size)
    for packet in range(len(data) // size):
        received = Received(data[size * packet : size * (packet + 1)], START + packet * count / RATE)
        stamper.add_chunk(received)
        for _, stamps in stamper.add(decoder.feed(received.data)):
            assert stamps.max() < received.time


def decoder_delay() -> float:
    """Return the age of a node in sample periods, as the standard decoder assumes it, when its last byte is sent."""
    nodes = standard.encode(np.linspace(0.0, 0.1, 40), np.ones(40), np.full(40, 20), np.arange(40) == 0)
    offset = decoder_for(0x81, 1 / RATE, BAUD, False).feed(nodes).samples["offset"][0]
    return float((-offset - 5 * 10 / BAUD) * RATE)


@settings(deadline=None)
@given(st.lists(st.lists(st.floats(0.0, 1e6), max_size=8), max_size=8))
def test_stamps_increase_strictly(chunks: list[list[float]]) -> None:
    onward = MonotonicStamps()
    fitted = np.concatenate([np.empty(0), *chunks])
    stamps = np.concatenate([np.empty(0), *(onward.stamps(np.array(chunk, dtype=float)) for chunk in chunks)])
    assert np.all(np.diff(stamps) > 0.0)
    assert np.all(stamps >= fitted)
    assert np.all(stamps <= np.maximum.accumulate(fitted) + len(fitted) * MIN_SPACING)


def test_increasing_stamps_are_not_changed() -> None:
    fitted = 1e5 + np.cumsum(np.full(1000, 1 / 32000))
    np.testing.assert_allclose(MonotonicStamps().stamps(fitted), fitted, rtol=0.0, atol=1e-10)


def test_stamps_follow_a_corrected_clock_at_once() -> None:
    onward = MonotonicStamps()
    true = 1e5 + 0.01 * np.arange(100)
    stamps = np.concatenate([onward.stamps(true[:50] + 0.08), onward.stamps(true[50:])])
    np.testing.assert_allclose(stamps[58:], true[58:], rtol=0.0, atol=1e-4)


@pytest.mark.parametrize("period", [0.0043, 0.015])
def test_one_late_read_does_not_count_as_a_loss(period: float) -> None:
    """Even if its last packet is decoded only with the next read."""
    clock = PacketCountClock(period)
    for count in range(200):
        arrived = START + count * period
        late = count in (100, 101)
        stamp = clock.stamp(count, START + 101 * period + 2 * LOSS_DELAY if late else arrived)
        assert stamp == pytest.approx(arrived, abs=1e-6)
    assert (clock.lost, clock.clock.jumps) == (0, 0)


def test_loss_of_whole_packets_is_detected() -> None:
    clock = PacketCountClock(0.015)
    for count in range(200):
        true = START + (count + (20 if count >= 100 else 0)) * 0.015
        stamp = clock.stamp(count, true)
        if count != 100:  # this one may have been delayed
            assert stamp == pytest.approx(true, abs=1e-6)
    assert (clock.lost, clock.clock.jumps) == (20, 1)


def test_late_reads_that_are_not_complete_do_not_count_as_a_loss() -> None:
    """The host was held up for 0.4 s, and then reads a fifth of what has come every 10 ms."""
    clock, period = PacketCountClock(0.0043), 0.0043
    ends = range(219, 300, 20)
    for count in range(200):
        clock.stamp(count, START + count * period)
    for k, count in enumerate(ends):
        stamp = clock.stamp(count, START + 300 * period + 0.01 * k, complete=count == ends[-1])
        assert stamp == pytest.approx(START + count * period, abs=1e-6)
    assert (clock.lost, clock.clock.jumps) == (0, 0)


def test_delay_of_the_host_after_a_loss_is_not_taken_for_more_of_it() -> None:
    clock, period, lost = PacketCountClock(0.0043), 0.0043, 15
    for count in range(200):
        clock.stamp(count, START + count * period)
    clock.stamp(200, START + (200 + lost) * period)
    late = START + (220 + lost) * period
    assert clock.stamp(220, late + 0.6) == pytest.approx(late, abs=1e-6)
    assert (clock.lost, clock.clock.jumps) == (lost, 1)
