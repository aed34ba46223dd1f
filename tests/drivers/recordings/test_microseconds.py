"""Stamps whose microseconds were written without leading zeros."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers import Odometry, Scan
from drivers.recordings.carmen import CarmenReader
from drivers.recordings.microseconds import restore_microseconds

Integers = NDArray[np.int64]


def clock(count: int = 3000, period: float = 0.1, jitter: float = 0.02, seed: int = 1) -> Integers:
    """Return increasing times of a periodic sensor in microseconds."""
    random = np.random.default_rng(seed)
    steps = np.maximum(random.normal(period, jitter, count), 1e-3)
    return np.cumsum((steps * 1e6).astype(np.int64)) + 976052857_000000


def unpadded(times: Integers) -> list[bytes]:
    """Write times as a logger does that prints seconds and microseconds as two integers."""
    return [f"{time // 1_000_000}.{time % 1_000_000}".encode() for time in times.tolist()]


def reprinted(times: Integers) -> list[bytes]:
    """Write times like `unpadded`, then read them as numbers and print them with six decimals."""
    return [f"{float(stamp):.6f}".encode() for stamp in unpadded(times)]


def padded(times: Integers) -> list[bytes]:
    return [f"{time // 1_000_000}.{time % 1_000_000:06d}".encode() for time in times.tolist()]


@pytest.mark.parametrize("write", [unpadded, reprinted])
@pytest.mark.parametrize("period", [0.02, 0.1, 0.3])
def test_lost_leading_zeros_are_restored(write: type[list[bytes]], period: float) -> None:
    times = clock(period=period, jitter=0.2 * period)
    restored = restore_microseconds(write(times))
    assert restored is not None
    errors = np.abs(np.array(restored) - times / 1e6)
    assert np.count_nonzero(errors) <= 0.02 * len(times)  # undecidable: both readings lie between the neighbours
    assert errors.max() < 1.5 * period


def test_stamps_with_leading_zeros_are_left_alone() -> None:
    disordered = clock()
    disordered[100::2] -= 150_000  # another sensor's lines reach the logger late
    assert restore_microseconds(padded(disordered)) is None


def test_increasing_stamps_without_a_small_fraction_are_left_alone() -> None:
    times = np.arange(976052857, 976055857) * 1_000_000 + 250_000  # one line a second
    assert restore_microseconds(padded(times)) is None


def test_disorder_that_leading_zeros_do_not_explain_is_left_alone() -> None:
    times = np.arange(976052857, 976055857) * 1_000_000 + 250_000
    times[1::2] -= 1_500_000
    assert restore_microseconds(padded(times)) is None


def test_few_stamps_are_left_alone() -> None:
    assert restore_microseconds(unpadded(clock(count=100))) is None
    assert restore_microseconds([]) is None


def test_a_log_is_read_in_the_order_of_its_lines(tmp_path: Path) -> None:
    times = clock(count=600, jitter=0.005)
    lines = [
        f"ODOM {1.0 + 0.01 * i:.2f} 0 0 0 0 0 {stamp} host 0.0\n"
        if i % 2
        else f"FLASER 3 1.0 2.0 3.0 {1.0 + 0.01 * i:.2f} 0 0 {1.0 + 0.01 * i:.2f} 0 0 {stamp} host 0.0\n"
        for i, stamp in enumerate(text.decode() for text in reprinted(times))
    ]
    path = tmp_path / "log.clf"
    path.write_text("".join(lines))
    source = CarmenReader(path)
    messages = list(source)
    odometry = [message for message in messages if isinstance(message, Odometry)]
    assert [message.pose[0] for message in odometry] == pytest.approx(1.0 + 0.01 * np.arange(600))
    assert [message.stamp for message in odometry] == pytest.approx(times / 1e6, abs=1e-3)
    assert sum(isinstance(message, Scan) for message in messages) == 300
    assert not source.report.reasons
    (text,) = source.report.interpretations
    assert "without leading zeros" in text


def test_seconds_that_no_clock_shows_are_left_as_they_are() -> None:
    assert restore_microseconds([5000 * b"7" + b".5", *unpadded(clock())]) is None
