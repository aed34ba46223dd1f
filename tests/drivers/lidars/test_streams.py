"""Properties of every decoder: damaged streams, any chunks, any bytes."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.lidars.measurements import Decoder, Measurements, StructuredArray
from drivers.lidars.revolutions import RevolutionAssembler

FUZZ = settings(max_examples=5, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])

StreamOf = Callable[..., Any]


def in_chunks(decoder: Decoder, data: bytes, sizes: list[int]) -> list[Measurements]:
    """Decode data in chunks whose sizes repeat."""
    out, at, k = [], 0, 0
    while at < len(data):
        out.append(decoder.feed(data[at : at + sizes[k % len(sizes)]]))
        at, k = at + sizes[k % len(sizes)], k + 1
    return out


def flattened(parts: list[Measurements]) -> tuple[StructuredArray, StructuredArray]:
    """Return all samples and packets, with the samples' packets numbered consecutively."""
    packets = np.concatenate([part.packets for part in parts])
    firsts = np.cumsum([0, *(len(part.packets) for part in parts)])
    samples = np.concatenate([part.samples for part in parts])
    samples["packet"] += np.repeat(firsts[:-1], [len(part) for part in parts])
    return samples, packets


def held_bytes(value: object, seen: set[int]) -> int:
    """Return the approximate memory of a decoder's buffers."""
    if id(value) in seen:
        return 0
    seen.add(id(value))
    if isinstance(value, bytes | bytearray):
        return len(value)
    if isinstance(value, np.ndarray):
        return value.nbytes if value.base is None else held_bytes(value.base, seen)
    if isinstance(value, list | tuple):
        return sum(held_bytes(item, seen) for item in value)
    return sum(held_bytes(item, seen) for item in vars(value).values()) if hasattr(value, "__dict__") else 0


def damaged(data: bytes, rate: float, kinds: str, random: np.random.Generator) -> tuple[bytes, int]:
    """Return data in which a share of the bytes was dropped, had one inserted before it, or had a bit flipped; and
    their number.
    """
    out, last = bytearray(), 0
    hits = np.flatnonzero(random.random(len(data)) < rate)
    for at in hits.tolist():
        out += data[last:at]
        last = at + 1
        match kinds[random.integers(len(kinds))]:
            case "i":
                out.append(int(random.integers(256)))
                out.append(data[at])
            case "f":
                out.append(data[at] ^ (1 << int(random.integers(8))))
    out += data[last:]
    return bytes(out), len(hits)


def points(samples: StructuredArray) -> np.ndarray:
    """Return direction + i range of all samples with a return."""
    valid = samples[~np.isnan(samples["range"])]
    return valid["angle"] + 1j * valid["range"]


def differences(clean: np.ndarray, got: np.ndarray) -> tuple[int, int]:
    """Return the numbers of wrong and of missing points."""
    return np.count_nonzero(~np.isin(got, clean)), np.count_nonzero(~np.isin(clean, got))


def test_a_clean_stream_is_decoded_without_loss(kind: str, stream_of: StreamOf) -> None:
    stream = stream_of(kind, 4)
    decoder = stream.decoder()
    measurements = decoder.feed(stream.data)
    counters = decoder.counters
    assert counters.bytes == len(stream.data)
    assert counters.samples == len(measurements) == len(measurements.samples)
    assert counters.bytes_skipped == counters.checksum_failures == counters.discarded == counters.implausible == 0
    assert measurements.packets["continuous"][1:].all()
    assert np.all(np.diff(measurements.packets["end"]) > 0)
    assert np.all(measurements.samples["offset"] < 0) or stream.whole_packets
    assert 0 < np.count_nonzero(~np.isnan(measurements.samples["range"])) < len(measurements)


def test_samples_are_evenly_spaced_in_time(kind: str, stream_of: StreamOf) -> None:
    """If bytes arrive evenly, the stamps of samples increase by the sample period throughout."""
    stream = stream_of(kind, 4)
    measurements = stream.decoder().feed(stream.data)
    if stream.whole_packets:
        stamps = measurements.samples["offset"][: stream.samples]
    else:
        per_byte = stream.seconds / len(stream.data)
        stamps = measurements.stamps(measurements.packets["end"] * per_byte)
    steps = np.diff(stamps)
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-6)


@FUZZ
@given(sizes=st.lists(st.integers(1, 700), min_size=1, max_size=20), seed=st.integers(0, 99))
@pytest.mark.parametrize("rate", [0.0, 1e-3])
def test_chunks_do_not_change_samples(kind: str, stream_of: StreamOf, rate: float, sizes: list[int], seed: int) -> None:
    stream = stream_of(kind, 0.5 if kind != "scip" else 1)
    data = damaged(stream.data, rate, "dif", np.random.default_rng(seed))[0]
    whole, parts = stream.decoder(), stream.decoder()
    expected = flattened([whole.feed(data)])
    got = flattened(in_chunks(parts, data, sizes))
    for one, other in zip(expected, got, strict=True):
        for name in one.dtype.names:
            np.testing.assert_array_equal(one[name], other[name])
    assert whole.counters == parts.counters


@FUZZ
@given(
    junk=st.lists(st.binary(max_size=300), max_size=8),
    cuts=st.lists(st.integers(0, 4000), min_size=8, max_size=8),
    sizes=st.lists(st.integers(1, 500), min_size=1, max_size=5),
)
def test_any_bytes_are_accepted(
    kind: str, stream_of: StreamOf, junk: list[bytes], cuts: list[int], sizes: list[int]
) -> None:
    stream = stream_of(kind, 1)
    data = b"".join(part + stream.data[cut : cut + 200] for part, cut in zip(junk, cuts, strict=False))
    decoder = stream.decoder()
    parts = in_chunks(decoder, data, sizes)
    for part in parts:
        assert np.all(np.abs(part.samples["angle"]) <= np.pi + 1e-12)
        assert not np.any(part.samples["range"] <= 0)
        assert not len(part) or part.samples["packet"].max() < len(part.packets)
    counters = decoder.counters
    assert counters.bytes == len(data)
    assert counters.bytes_skipped <= len(data)
    assert all(count >= 0 for count in counters.as_dict().values())


@pytest.mark.parametrize("pattern", ["random", "zeros", "marks", "lines", "endless line"])
def test_memory_is_bounded_for_any_input(kind: str, stream_of: StreamOf, pattern: str) -> None:
    stream = stream_of(kind, 0.5 if kind != "scip" else 1)
    junk = {
        "random": np.random.default_rng(3).bytes(40_000),
        "zeros": bytes(40_000),
        "marks": b"\xa5\x5a\x54\x2c" * 10_000,
        "lines": b"MD\n99b\n" * 5_700,
        "endless line": b"x" * 40_000,
    }[pattern]
    decoder = stream.decoder()
    decoder.feed(junk)
    before = held_bytes(decoder, set())
    for _ in range(3):
        decoder.feed(junk)
    assert held_bytes(decoder, set()) <= max(before, 40_000)
    # afterwards, a stream is decoded again
    got = sum(len(decoder.feed(part.data)) for part in [stream, stream, stream])
    assert got > stream.samples * (len(stream.data) // 4000)


def cost_of_faults(stream: Any, kinds: str, least: int) -> tuple[float, float]:
    """Return wrong and missing points per fault, with one fault in 10 000 bytes, over at least `least` faults."""
    random = np.random.default_rng(11)
    clean = points(stream.decoder().feed(stream.data).samples)
    faults = wrong = lost = 0
    while faults < least:
        data, count = damaged(stream.data, 1e-4, kinds, random)
        off, missing = differences(clean, points(stream.decoder().feed(data).samples))
        faults, wrong, lost = faults + count, wrong + off, lost + missing
    return wrong / faults, lost / faults


def test_faults_lose_few_points_and_make_hardly_any_wrong(kind: str, stream_of: StreamOf) -> None:
    standard = kind.startswith("standard")
    wrong, lost = cost_of_faults(stream_of(kind, 20), "dif", 150 if standard else 30)
    assert wrong <= (0.3 if standard else 0.02)
    assert lost <= (3 if standard else 2.1 * stream_of(kind, 1).samples)


@pytest.mark.parametrize("kind", [pytest.param("standard-a1", marks=pytest.mark.slow), "standard-c1"])
@pytest.mark.parametrize(("kinds", "bound"), [("d", 0.05), ("i", 0.15), ("f", 0.8)])
def test_faults_do_not_spread_in_nodes_without_checksum(
    kind: str, stream_of: StreamOf, kinds: str, bound: float
) -> None:
    """Flipped bits of a distance cannot be detected; shifts of the following nodes can."""
    wrong, lost = cost_of_faults(stream_of(kind, 20), kinds, 100)
    assert wrong <= bound
    assert lost <= 3


def test_long_losses_and_bursts_create_no_wrong_points(kind: str, stream_of: StreamOf) -> None:
    """After bytes were removed or inserted, the decoded points are a subset of the true ones."""
    stream = stream_of(kind, 12)
    clean = points(stream.decoder().feed(stream.data).samples)
    random = np.random.default_rng(5)
    wrong = 0
    for length in (1, 3, 37, 84, 500, 4096):
        at = int(random.integers(len(stream.data) // 3, len(stream.data) // 2))
        for data in (
            stream.data[:at] + stream.data[at + length :],
            stream.data[:at] + random.bytes(length) + stream.data[at:],
        ):
            off, missing = differences(clean, points(stream.decoder().feed(data).samples))
            wrong += off
            assert missing <= 3 * stream.samples + 80 + length
    assert wrong <= 6


def test_every_revolution_of_a_clean_stream_is_complete(kind: str, stream_of: StreamOf) -> None:
    stream = stream_of(kind, 6)
    decoder = stream.decoder()
    assembler = RevolutionAssembler(0.05, 40.0, whole_packets=stream.whole_packets)
    scans = []
    per_byte = stream.seconds / len(stream.data)
    for part in in_chunks(decoder, stream.data, [333]):
        scans += assembler.add(part, part.stamps(part.packets["end"] * per_byte))
    assert len(scans) >= 4
    assert assembler.counters.incomplete == 0
    assert assembler.counters.complete == len(scans)
    for scan in scans:
        assert np.all(np.diff(scan.angles) > 0)
        assert scan.time_offsets.min() == 0.0
        assert scan.time_offsets.max() < 0.12
        assert np.ptp(scan.angles) > np.radians(350) or stream.whole_packets
        if kind in ("dense", "ultra-dense", "hq", "ld06", "standard-c1"):
            assert np.all(np.diff(scan.time_offsets) < 0)  # the lidars turn clockwise
        walls = 2.5 / np.maximum(np.abs(np.cos(scan.angles)), np.abs(np.sin(scan.angles)))
        # the room is symmetric, so mirrored angles do not matter, and nothing is farther than its walls
        if kind not in ("ultra", "express", "standard-a1"):
            assert np.nanmax(scan.ranges - walls) < 0.1
    periods = np.diff([scan.stamp for scan in scans])
    np.testing.assert_allclose(periods, periods.mean(), atol=2.5e-3)


def test_damaged_revolutions_become_scans_or_are_counted(stream_of: StreamOf) -> None:
    stream = stream_of("dense", 60)
    data, _ = damaged(stream.data, 1e-4, "dif", np.random.default_rng(2))
    decoder, assembler = stream.decoder(), RevolutionAssembler(0.05, 40.0)
    measurements = decoder.feed(data)
    arrivals = measurements.packets["end"] * (stream.seconds / len(stream.data))
    scans = assembler.add(measurements, measurements.stamps(arrivals))
    assert len(scans) + assembler.counters.incomplete in (58, 59)
    assert len(scans) >= 55


def test_decoding_takes_less_than_a_tenth_of_real_time(stream_of: StreamOf) -> None:
    """32 000 points per second, decoded and assembled from chunks of 10 ms, in processor time."""
    stream = stream_of("ultra-dense", 20)
    assert 30_000 < stream.samples * len(stream.data) / 170 / stream.seconds < 34_000
    chunk = int(len(stream.data) / stream.seconds * 0.01)
    decoder, assembler = stream.decoder(), RevolutionAssembler(0.05, 40.0)
    begin = time.process_time()
    for part in in_chunks(decoder, stream.data, [chunk]):
        assembler.add(part, part.stamps(part.packets["end"] * 1e-6))
    assert (time.process_time() - begin) / stream.seconds < 0.1
