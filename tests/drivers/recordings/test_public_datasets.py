"""Public benchmark recordings, if they are available."""

from __future__ import annotations

import time
import tomllib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers import Message, Odometry, Scan
from slam.evaluation.benchmarks.reference_work import ReferenceWork

from ...recordings import recording_file

ROOT = Path(__file__).parents[3]
MAX_TIME = 1500
"""Processor time of reading a recording relative to that of a computation of 2 ms, done meanwhile: other programs slow
down both. It is 400 to 700, with the compiled functions loaded for the first time.
"""
CATALOGUE = tomllib.loads((ROOT / "datasets" / "catalogue.toml").read_text())["recording"]


def test_published_log_is_read_in_the_order_of_its_lines() -> None:
    """The log as published lost zeros of its stamps; read in another order, its odometry goes back and forth."""
    source = drivers.open(recording_file("intel-full"))
    info = drivers.inspect(source)
    assert info.path_length == pytest.approx(503, rel=0.01)
    assert sum(info.report.reasons.values()) <= 2
    assert len(info.report.recorded_stamps) == pytest.approx(0.1 * info.odometry, rel=0.1)


@pytest.mark.parametrize(
    ("name", "beams", "mount", "length"),
    [("intel", 180, [0, 0, 0], 503), ("fr079", 360, [-0.04, 0, 0], 393), ("csail", 361, [0, 0, 0], 374)],
)
def test_benchmark_recording_is_read_completely(name: str, beams: int, mount: list[float], length: float) -> None:
    path = recording_file(name)
    source = drivers.open(path)
    messages: list[Message] = []
    reference, units = ReferenceWork(), []
    start = time.process_time()
    for message in source:
        messages.append(message)
        if len(messages) % 200 == 1:
            units.append(reference.time_once())
    assert time.process_time() - start - sum(units) < MAX_TIME * np.mean(units)
    counts = Counter(type(message) for message in messages)
    assert counts[Odometry] == CATALOGUE[name]["odometry"]
    assert counts[Scan] == CATALOGUE[name]["scans"]
    assert len(source) == len(messages)
    assert source.report.skipped == 0
    assert source.report.reasons == {}
    for scan in (message for message in messages if isinstance(message, Scan)):
        assert len(scan.ranges) == beams
        assert np.array_equal(scan.mount, mount) if scan.mount is not None else False
    info = drivers.inspect(source)
    assert info.path_length == pytest.approx(length, abs=1.0)
